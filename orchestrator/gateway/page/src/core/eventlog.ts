/** The events that this page has seen: the state has the newest hundred, this keeps more, but not without end. */

import { effect, signal } from "@preact/signals";
import type { FleetEvent } from "./model.ts";
import { events } from "./store.ts";

const MOST = 1000;

/** Newest first. */
export const eventLog = signal<FleetEvent[]>([]);

export function watchEvents(): void {
  effect(() => {
    const seen = eventLog.peek();
    const last = seen[0]?.n ?? -1;
    const newest = events.value.at(-1)?.n ?? -1;
    // Numbers that begin again belong to another gateway: its list replaces what was here.
    if (newest < last) eventLog.value = [...events.value].reverse();
    else {
      const fresh = events.value.filter((event) => event.n > last);
      if (fresh.length > 0) eventLog.value = [...fresh.reverse(), ...seen].slice(0, MOST);
    }
  });
}
