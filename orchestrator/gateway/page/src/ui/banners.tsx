/** What must not be overlooked, and stays until it is over or dismissed. */

import type { JSX } from "preact";
import { timeOfDay } from "../core/format.ts";
import { dismiss, notices } from "../core/notices.ts";
import { whyNot } from "../core/rights.ts";
import { resetFleet, stoppedBy } from "../core/stop.ts";
import { controllers, coordinator, loaded } from "../core/store.ts";
import { connection, pageAge, session } from "../core/stream.ts";
import { T } from "../texts.ts";
import { Act } from "./parts.tsx";

export function Banners(): JSX.Element {
  const estopped = controllers.value.filter((controller) => controller.rest.value.estop);
  const estop = estopped[0]?.rest.value.estop;
  const stopped = stoppedBy.value;
  return (
    <div class="banners">
      {connection.value !== "open" ? (
        <div class="banner bad" role="alert">
          <span aria-hidden="true">▲</span> {T.banner.lost(pageAge.value)}
        </div>
      ) : null}
      {connection.value === "open" && loaded.value && !coordinator.value.present ? (
        <div class="banner bad" role="alert">
          <span aria-hidden="true">▲</span> {T.banner.noCoordinator}
        </div>
      ) : null}
      {estop ? (
        <div class="banner bad" role="alert">
          <span aria-hidden="true">■</span> {T.banner.estop(estopped.map((each) => each.id).join(", "), estop.actor, estop.reason, timeOfDay(estop.utc))}
          <Act label={T.stop.reset} kind="small" why={whyNot("reset")} onAct={() => void resetFleet()} />
        </div>
      ) : null}
      {stopped ? (
        <div class="banner warn" role="status">
          <span aria-hidden="true">■</span> {T.banner.stopped(stopped.what, stopped.by, timeOfDay(stopped.utc))}
          <Act label={T.dismiss} kind="small" onAct={() => (stoppedBy.value = null)} />
        </div>
      ) : null}
      {session.value && !session.value.users ? <p class="banner quiet">{T.banner.noUsers}</p> : null}
      <ul class="notices" aria-live="polite">
        {notices.value.map((notice) => (
          <li key={notice.key} class={`banner ${notice.kind === "refusal" ? "warn" : ""}`}>
            <span>
              <span aria-hidden="true">{notice.kind === "refusal" ? "▲" : "ℹ"}</span> <b>{notice.title}</b>
              {notice.count > 1 ? ` (${notice.count}×)` : ""} {notice.controller ? `${notice.controller}: ` : ""}
              {notice.text} {notice.remedy ? <span class="remedy">{notice.remedy}</span> : null}
              {notice.code ? <code>{notice.code}</code> : null}
            </span>
            <Act label={T.dismiss} kind="small" onAct={() => dismiss(notice.key)} />
          </li>
        ))}
      </ul>
    </div>
  );
}
