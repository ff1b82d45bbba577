/** Which axes are to be seen first in a long table: those that move, then those that are not ready. */

import { effect, signal } from "@preact/signals";
import { readinessOf } from "./ready.ts";
import { owners, permits } from "./store.ts";

const RANKS = { busy: 0, bad: 1, off: 1, ok: 2 };
const LAST = 2;
/** How long an axis keeps its place after its reason has gone: a table that changes with each step cannot be read. */
const KEEP_MS = 5000;

/** The rank of each axis, the first is 0; one that is absent has the last. */
export const attention = signal<Record<string, number>>({});

export function rankOf(axis: string): number {
  return attention.value[axis] ?? LAST;
}

export function watchAttention(): void {
  const untilMs = new Map<string, number>();
  const again = signal(0);
  let timer = 0;
  effect(() => {
    again.value;
    const now = performance.now();
    const before = attention.peek();
    const next: Record<string, number> = {};
    let soonest = Infinity;
    for (const controller of owners.value)
      for (const axis of controller.axes.value) {
        const rank = RANKS[readinessOf(axis.id, axis.flags.value, controller.rest.value, permits.value).level];
        const kept = before[axis.id] ?? LAST;
        if (rank <= kept) untilMs.set(axis.id, now + KEEP_MS);
        const end = untilMs.get(axis.id) ?? 0;
        const shown = rank <= kept || end <= now ? rank : kept;
        if (shown < rank) soonest = Math.min(soonest, end);
        if (shown < LAST) next[axis.id] = shown;
      }
    clearTimeout(timer);
    if (soonest < Infinity) timer = setTimeout(() => (again.value += 1), soonest - now + 1);
    const same = Object.keys(before).length === Object.keys(next).length && Object.entries(next).every(([id, rank]) => before[id] === rank);
    if (!same) attention.value = next;
  });
}
