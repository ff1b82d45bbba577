/** What this browser remembers: theme, sound, view, chosen axes. And which view is shown. */

import { effect, signal, type Signal } from "@preact/signals";
import { isBusy } from "./manual.ts";
import { showNote } from "./notices.ts";
import { T } from "../texts.ts";

export type View = "run" | "setup" | "service";
export const VIEWS: View[] = ["run", "setup", "service"];
export type Theme = "auto" | "light" | "dark";

/** A signal whose value outlives the page. A browser that keeps nothing is no fault. */
export function remembered<V>(name: string, first: V, check: (value: unknown) => value is V): Signal<V> {
  const key = `tutti.${name}`;
  let value = first;
  try {
    const read: unknown = JSON.parse(localStorage.getItem(key) ?? "null");
    if (check(read)) value = read;
  } catch {
    // nothing was kept
  }
  const kept = signal(value);
  effect(() => {
    const text = JSON.stringify(kept.value);
    try {
      localStorage.setItem(key, text);
    } catch {
      // nothing can be kept
    }
  });
  return kept;
}

export const isText = (value: unknown): value is string => typeof value === "string";
export const isNumber = (value: unknown): value is number => typeof value === "number";
export const isFlag = (value: unknown): value is boolean => typeof value === "boolean";
export const isTexts = (value: unknown): value is string[] => Array.isArray(value) && value.every(isText);

export const theme = remembered<Theme>("theme", "auto", (value): value is Theme => ["auto", "light", "dark"].includes(value as string));
export const soundOn = remembered("sound", false, isFlag);
export const plotted = remembered<string[]>("plotted", [], isTexts);

export const view = signal<View>(viewOfAddress() ?? "run");

function viewOfAddress(): View | undefined {
  return VIEWS.find((each) => location.hash === `#${each}`);
}

/** Change the view, unless an axis is under manual control of this page: what moves stays in sight. */
export function showView(next: View): void {
  if (next === view.value) return;
  if (isBusy.value) {
    history.replaceState(null, "", `#${view.value}`);
    showNote(T.view.locked, T.view.lockedRemedy);
    return;
  }
  view.value = next;
  history.replaceState(null, "", `#${next}`);
}

export function watchAddress(): void {
  window.addEventListener("hashchange", () => {
    const asked = viewOfAddress();
    if (asked) showView(asked);
  });
  effect(() => {
    if (theme.value === "auto") delete document.documentElement.dataset["theme"];
    else document.documentElement.dataset["theme"] = theme.value;
  });
}
