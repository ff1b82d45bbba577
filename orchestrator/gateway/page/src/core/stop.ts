/** Stop and e-stop: by the socket, or by a request if the socket is closed. Never with a question before. */

import { signal } from "@preact/signals";
import { post } from "./http.ts";
import { cancelWork, endJog } from "./manual.ts";
import type { Answer, Stopped } from "./model.ts";
import { showNote, showRefusal } from "./notices.ts";
import { ask, isOpen, listen, noConnection } from "./stream.ts";
import * as T from "../texts.ts";

export type StopKind = "stop" | "estop";

/** The last stop of the fleet, with its user; shown until it is dismissed. */
export const stoppedBy = signal<Stopped | null>(null);
/** The last request of this page, until it is answered. */
export const pendingStop = signal<StopKind | null>(null);

const ESTOP = { do: "estop", reason: T.stop.estopReason };
const STOP = { do: "stop" };

export function stopFleet(kind: StopKind): void {
  // Nothing comes before it: the frame is on its way when `ask` returns.
  const asked = isOpen() ? ask(kind === "stop" ? STOP : ESTOP) : null;
  const answer = asked === null ? request(kind) : orRequest(asked, kind);
  endJog();
  cancelWork();
  pendingStop.value = kind;
  void answer.then((done) => finish(kind, done));
}

/** How long a socket that looks open may take before a request goes beside it. A stop twice is no harm. */
const PATIENCE_MS = 1000;

function orRequest(asked: Promise<Answer>, kind: StopKind): Promise<Answer> {
  return new Promise((resolve) => {
    const timer = setTimeout(() => resolve(request(kind)), PATIENCE_MS);
    void asked.then((answer) => {
      clearTimeout(timer);
      // A socket that was closed meanwhile has carried nothing for certain.
      resolve("refused" in answer && answer.refused.code === noConnection().code ? request(kind) : answer);
    });
  });
}

function request(kind: StopKind): Promise<Answer> {
  return post<Record<string, unknown>>(kind, kind === "stop" ? {} : { reason: T.stop.estopReason });
}

function finish(kind: StopKind, answer: Answer): void {
  pendingStop.value = null;
  if ("refused" in answer) showRefusal(T.stop.failed[kind], { ...answer.refused, remedy: T.stop.failedRemedy }, true);
}

listen({
  onStopped(stopped) {
    stoppedBy.value = stopped;
    for (const [controller, refusal] of Object.entries(stopped.answers ?? {}))
      if (refusal) showRefusal(T.stop.notStopped(controller), { ...refusal, controller }, true);
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
