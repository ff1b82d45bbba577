/**
 * Keys that act everywhere, each with one meaning at a time.
 *
 * The stop keys always stop. Esc closes what is open, and stops nothing then; with nothing open it stops.
 */

import { signal } from "@preact/signals";
import { isText, remembered } from "./remember.ts";
import { stopFleet } from "./stop.ts";

/** Keys that a user may choose to stop by, beside Pause: none of them does anything else on the page. */
export const STOP_KEYS = ["", "F8", "F9", "F10", "ScrollLock"];
export const stopKey = remembered("stop.key", "", isText);

/** How to close what is open, the newest last. */
const open: (() => void)[] = [];
/** How many things are open. */
export const openCount = signal(0);

/** Something that Esc closes has been opened; call the result when it is closed. */
export function noteOpen(close: () => void): () => void {
  open.push(close);
  openCount.value = open.length;
  return () => {
    const at = open.indexOf(close);
    if (at >= 0) open.splice(at, 1);
    openCount.value = open.length;
  };
}

/** Close the newest thing that is open; false: there is none. */
function closeNewest(): boolean {
  const close = open.at(-1);
  if (close !== undefined) {
    close();
    return true;
  }
  if (document.fullscreenElement !== null) {
    void document.exitFullscreen();
    return true;
  }
  return false;
}

/** A list or calendar of the browser itself is open: the browser closes it at Esc. */
function hasOpenList(): boolean {
  try {
    return document.querySelector("select:open, input:open") !== null;
  } catch {
    return false; // a browser that does not know it keeps the key from the page
  }
}

function isStopKey(event: KeyboardEvent): boolean {
  return event.key === "Pause" || event.code === "Pause" || (stopKey.value !== "" && event.key === stopKey.value);
}

export function watchKeys(): void {
  window.addEventListener(
    "keydown",
    (event) => {
      const stops = isStopKey(event);
      if (!stops && (event.key !== "Escape" || event.isComposing || hasOpenList())) return;
      event.preventDefault();
      if (event.repeat) return;
      if (stops || !closeNewest()) stopFleet("stop");
    },
    { capture: true },
  );
}
