/** What this browser remembers: theme, sound, view, chosen axes. And which view is shown. */

import { effect, signal } from "@preact/signals";
import { isBusy } from "./manual.ts";
import { showNote } from "./notices.ts";
import { isFlag, isTexts, remembered } from "./remember.ts";
import * as T from "../texts.ts";

export type View = "run" | "setup" | "service";
export const VIEWS: View[] = ["run", "setup", "service"];
export type Theme = "auto" | "light" | "dark";

export const theme = remembered<Theme>("theme", "auto", (value): value is Theme => ["auto", "light", "dark"].includes(value as string));
export const soundOn = remembered("sound", false, isFlag);
/** The view of two axes in their plane. */
export interface Plane {
  shown: boolean;
  axes: string[];
}

function isPlane(value: unknown): value is Plane {
  if (typeof value !== "object" || value === null) return false;
  const { shown, axes } = value as Record<string, unknown>;
  return isFlag(shown) && isTexts(axes);
}

export const plane = remembered<Plane>("plane", { shown: false, axes: [] }, isPlane);
export const plotted = remembered<string[]>("plotted", [], isTexts);

/** Whether the panels stand one below the other; the same condition as in the style sheet. */
export const stacked = signal(false);
const WIDE = window.matchMedia("(min-width: 1000px) and (min-height: 600px)");
stacked.value = !WIDE.matches;
WIDE.addEventListener("change", () => (stacked.value = !WIDE.matches));

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
