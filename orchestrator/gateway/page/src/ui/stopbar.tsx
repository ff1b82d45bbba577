/** The stop bar: always there, for every role, without a question. */

import type { JSX } from "preact";
import { pendingStop, stopFleet, type StopKind } from "../core/stop.ts";
import * as T from "../texts.ts";

/** It acts when it is pressed, not when it is let go; keys press it by `click`. */
function StopButton({ kind }: { kind: StopKind }): JSX.Element {
  let pointed = false;
  return (
    <button
      type="button"
      class={`stop ${kind}`}
      title={T.stop.title[kind]}
      aria-busy={pendingStop.value === kind}
      onPointerDown={(event) => {
        if (event.button !== 0) return;
        pointed = true;
        stopFleet(kind);
      }}
      onClick={() => {
        if (!pointed) stopFleet(kind);
        pointed = false;
      }}
    >
      {T.stop.label[kind]}
    </button>
  );
}

export function StopBar(): JSX.Element {
  return (
    <section class="stopbar" aria-label={T.stop.bar}>
      <StopButton kind="stop" />
      <StopButton kind="estop" />
    </section>
  );
}
