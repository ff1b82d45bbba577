/** Keys that act everywhere: Esc and Pause stop the fleet, and close what is open. */

import { signal } from "@preact/signals";
import { stopFleet } from "./stop.ts";

/** Increases when everything that is open has to close: menus, dialogs, a drag. */
export const closeAll = signal(0);

export function watchKeys(): void {
  window.addEventListener(
    "keydown",
    (event) => {
      if (event.key !== "Escape" && event.key !== "Pause") return;
      event.preventDefault();
      if (event.repeat) return;
      stopFleet("stop");
      closeAll.value += 1;
    },
    { capture: true },
  );
}
