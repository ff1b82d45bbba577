/** Stop and e-stop: by the socket, or by a request if the socket is closed. Never with a question before. */

import { signal } from "@preact/signals";
import { post } from "./http.ts";
import { cancelWork, endJog } from "./manual.ts";
import type { Answer, Stopped } from "./model.ts";
import { showNote, showRefusal } from "./notices.ts";
import { ask, isOpen, listen } from "./stream.ts";
import { T } from "../texts.ts";

export type StopKind = "stop" | "estop";

/** Who stopped the fleet last; shown until it is dismissed. */
export const stoppedBy = signal<Stopped | null>(null);
/** The last request of this page, until it is answered. */
export const pendingStop = signal<StopKind | null>(null);

const ESTOP = { do: "estop", reason: T.stop.estopReason };
const STOP = { do: "stop" };

export function stopFleet(kind: StopKind): void {
  // Nothing comes before it: the frame is on its way when `ask` returns.
  const answer = isOpen() ? ask(kind === "stop" ? STOP : ESTOP) : post<Record<string, unknown>>(kind, kind === "stop" ? {} : { reason: T.stop.estopReason });
  endJog();
  cancelWork();
  pendingStop.value = kind;
  void answer.then((done) => finish(kind, done));
}

function finish(kind: StopKind, answer: Answer): void {
  pendingStop.value = null;
  if ("refused" in answer) showRefusal(T.stop.failed[kind], { ...answer.refused, remedy: T.stop.failedRemedy });
}

listen({
  onStopped(stopped) {
    stoppedBy.value = stopped;
    for (const [controller, refusal] of Object.entries(stopped.answers ?? {}))
      if (refusal) showRefusal(T.stop.notStopped(controller), { ...refusal, controller });
  },
});

/** Clear the latches of all controllers. */
export async function resetFleet(): Promise<void> {
  const answer = await post<{ answers?: Record<string, { text: string; code: string; remedy?: string } | null> }>("reset");
  if ("refused" in answer) return showRefusal(T.stop.resetRefused, answer.refused);
  const refused = Object.entries(answer.ok.answers ?? {}).filter(([, refusal]) => refusal !== null);
  for (const [controller, refusal] of refused)
    if (refusal) showRefusal(T.stop.resetRefused, { ...refusal, controller });
  if (refused.length === 0) showNote(T.stop.resetDone);
}
