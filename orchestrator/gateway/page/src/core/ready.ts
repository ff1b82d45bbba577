/** Whether an axis could move now: if not, why, and what to do about it. */

import { withoutAddress } from "./format.ts";
import type { ControllerRest } from "./store.ts";
import type { AxisState, Permit } from "./model.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";

/** ok: it is ready; busy: it does something; off: it needs a command first; bad: it is abnormal. */
export type Level = "ok" | "busy" | "off" | "bad";

export interface Readiness {
  level: Level;
  text: string;
  remedy: string;
}

export function readinessOf(id: string, axis: AxisState, controller: ControllerRest, permits: Permit[]): Readiness {
  const [owner = "", name = ""] = id.split(".");
  const bad = (text: string, remedy: string): Readiness => ({ level: "bad", text: onPage(text), remedy: onPage(remedy) });
  if (!controller.present) return bad(T.ready.noAdapter, T.ready.noAdapterRemedy(owner));
  if (controller.mode === "offline") return bad(T.ready.offline, firstFault(controller, name)?.remedy || T.ready.offlineRemedy);
  if (controller.estop) return bad(T.ready.estop(withoutAddress(controller.estop.actor)), T.ready.estopRemedy);
  const fault = firstFault(controller, name);
  if (fault) return bad(fault.text, fault.remedy);
  if (axis.fault) return bad(axis.fault, T.ready.faultRemedy);
  if (axis.limit && axis.limit !== "none") return bad(T.ready.limit(axis.limit), T.ready.limitRemedy);
  const permit = permits.find((each) => each.axes.includes(id));
  if (permit) return bad(T.ready.permit(permit.name), permit.text);
  if (axis.homing) return { level: "busy", text: T.ready.homing, remedy: "" };
  if (axis.moving) return { level: "busy", text: T.ready.moving, remedy: "" };
  if (!axis.enabled) return { level: "off", text: T.ready.disabled, remedy: T.ready.disabledRemedy };
  if (!axis.referenced) return { level: "off", text: T.ready.unreferenced, remedy: T.ready.unreferencedRemedy };
  return { level: "ok", text: T.ready.ok, remedy: "" };
}

function firstFault(controller: ControllerRest, axis: string): { text: string; remedy: string } | undefined {
  const faults = controller.faults ?? [];
  return faults.find((fault) => fault.axis === axis) ?? faults.find((fault) => !fault.axis);
}
