/** Why a command cannot be given now; empty: it can. The gateway decides, the page only says so before. */

import { connection, isStale, pageAge, session } from "./stream.ts";
import { coordinator, findController } from "./store.ts";
import * as T from "../texts.ts";

/** Verbs that the gateway does by itself, without a coordinator. */
const WITHOUT_COORDINATOR = new Set(["reset", "check-job", "check-fleet", "forget"]);

export function whyNot(verb: string, controller = ""): string {
  if (connection.value !== "open") return T.why.noConnection;
  if (isStale.value) return T.why.stale(pageAge.value);
  const now = session.value;
  if (now !== null && !now.may.includes(verb)) return T.why.role(now.role);
  if (!WITHOUT_COORDINATOR.has(verb) && !coordinator.value.present) return T.why.noCoordinator;
  return controller ? whyNotController(controller) : "";
}

/** Whether jobs of this user wait for an approval. */
export function proposes(): boolean {
  return !(session.value?.may.includes("approve") ?? false);
}

function whyNotController(id: string): string {
  const controller = findController(id);
  if (controller === undefined) return T.why.unknownController(id);
  const rest = controller.rest.value;
  if (!rest.present) return T.why.noAdapter(id);
  if (controller.age.value >= 1) return T.why.oldController(id, controller.age.value);
  if (rest.mode === "offline") return T.why.offline(id);
  if (rest.estop) return T.why.estop(id);
  return "";
}

/** The first reason of several. */
export function firstOf(...reasons: string[]): string {
  return reasons.find((reason) => reason !== "") ?? "";
}
