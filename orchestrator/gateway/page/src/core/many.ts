/**
 * A fleet of many controllers: the page asks for those that it shows, and for those that something on it depends on.
 *
 * Of the others it has the counts, and the first names of those in trouble.
 */

import { computed, effect, signal, untracked } from "@preact/signals";
import { get } from "./http.ts";
import { plane, plotted } from "./look.ts";
import { held } from "./manual.ts";
import { counts, MANY } from "./store.ts";
import { need } from "./stream.ts";
import * as T from "../texts.ts";

export const SHOWN = 24;
const MOST_NAMED = 5;
const MOST_FIRST = 8; // controllers in one trouble that come before all others
const PARTS = ["virtual", "jobs", "paths", "alarms", "events", "queue", "views"];

export const isMany = computed(() => (counts.value?.controllers ?? 0) > MANY);
/** A part of the names that are to be shown, and which of these is the first. */
export const filter = signal("");
export const first = signal(0);
/** A dialog is open: what it shows stays, whatever comes into trouble meanwhile. */
export const still = signal(false);
/** Controllers that a dialog needs. */
export const wanted = signal<string[]>([]);
/** What returns axes or controllers that a part of the page depends on. */
export const keepers: (() => string[])[] = [() => held.value, () => plotted.value, () => plane.value.axes, () => wanted.value];

const names = signal<string[]>([]);
const troubled = computed(() => {
  const number: Record<string, number> = {};
  const all = Object.entries(counts.value?.troubled ?? {});
  return all.filter(([, trouble]) => (number[trouble] = (number[trouble] ?? 0) + 1) <= MOST_FIRST).map(([name]) => name);
});

/** The controllers that fit the filter: those in trouble before the others. */
export const matching = computed(() => {
  const text = filter.value.toLowerCase();
  return [...new Set([...troubled.value, ...names.value])].filter((name) => name.includes(text));
});
const controllerOf = (id: string): string => id.split(".")[0] ?? "";
/** What is under manual control stays in sight. */
export const shown = computed(() => [...new Set([...matching.value.slice(first.value, first.value + SHOWN), ...held.value.map(controllerOf)])]);

/** The first controllers in a trouble, as a text; empty: none is. */
export function namesIn(trouble: string): string {
  const number = counts.value?.troubles[trouble] ?? 0;
  const some = Object.entries(counts.value?.troubled ?? {}).filter(([, each]) => each === trouble);
  const text = some.slice(0, MOST_NAMED).map(([name]) => name).join(", ");
  return number > MOST_NAMED ? T.many.andMore(text, number - MOST_NAMED) : text;
}

export function watchMany(): void {
  const configured = computed(() => (isMany.value ? counts.value?.configured : 0));
  effect(() => {
    if (configured.value) void get<{ controllers: string[] }>("names").then((answer) => ("ok" in answer ? (names.value = answer.ok.controllers) : null));
  });
  effect(() => {
    filter.value;
    first.value = 0;
  });
  effect(() => {
    if (!isMany.value) {
      need.value = null;
      return;
    }
    const kept = keepers.flatMap((keeper) => keeper()).map(controllerOf);
    const list = [...shown.value, ...troubled.value, ...kept.filter((name) => names.value.includes(name))];
    if (still.value && wanted.value.length === 0) return;
    const some = list.length > 0 ? ["leases", "members"] : [];
    const next = [...PARTS, ...some, ...new Set(list.map((name) => `controllers/${name}`))];
    untracked(() => {
      if (next.join() !== need.value?.join()) need.value = next;
    });
  });
}
