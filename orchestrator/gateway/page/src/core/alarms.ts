/** Alarms of the fleet, and how they are noticed from across the room: sound, title, icon. */

import { computed, effect } from "@preact/signals";
import { soundOn } from "./look.ts";
import type { Alarm } from "./model.ts";
import { alarms, fleetName } from "./store.ts";
import { connection } from "./stream.ts";
import * as T from "../texts.ts";

const ORDER = ["urgent", "critical", "high", "medium", "low"];
const REPEAT_MS = 8000;

export const isSetAside = (alarm: Alarm): boolean => Boolean(alarm.shelved_until_utc) || Boolean(alarm.out_of_service);

export const sortedAlarms = computed(() =>
  Object.values(alarms.value)
    .filter((alarm) => alarm.state !== "normal")
    .sort(
      (a, b) =>
        Number(isSetAside(a)) - Number(isSetAside(b)) ||
        Number(a.state !== "unacknowledged") - Number(b.state !== "unacknowledged") ||
        rank(a) - rank(b) ||
        b.raised_utc.localeCompare(a.raised_utc),
    ),
);

function rank(alarm: Alarm): number {
  const at = ORDER.indexOf(alarm.priority);
  return at < 0 ? ORDER.length : at;
}

/** Other computers reach the bus without TLS: shown as long as it is so, also when the alarm was acknowledged or shelved. */
export const openBus = computed(
  () => sortedAlarms.value.find((alarm) => alarm.kind === "open-bus" && alarm.state !== "returned")?.text ?? "",
);

/** Those that wait for a user. */
export const openAlarms = computed(() => sortedAlarms.value.filter((alarm) => !isSetAside(alarm)));
export const newAlarms = computed(() => openAlarms.value.filter((alarm) => alarm.state !== "acknowledged"));

let context: AudioContext | null = null;

/** Two short tones. The browser allows them only after the user has switched sound on by a press. */
export function beep(): void {
  try {
    context ??= new AudioContext();
    void context.resume();
    for (const [after, hertz] of [
      [0, 880],
      [0.18, 660],
    ] as const) {
      const tone = context.createOscillator();
      const gain = context.createGain();
      const begin = context.currentTime + after;
      tone.frequency.value = hertz;
      gain.gain.setValueAtTime(0.0001, begin);
      gain.gain.exponentialRampToValueAtTime(0.2, begin + 0.02);
      gain.gain.exponentialRampToValueAtTime(0.0001, begin + 0.15);
      tone.connect(gain).connect(context.destination);
      tone.start(begin);
      tone.stop(begin + 0.16);
    }
  } catch {
    // a browser without sound: title and icon show it too
  }
}

export function watchAlarms(): void {
  effect(() => {
    const count = newAlarms.value.length;
    const away = connection.value === "lost" ? `${T.title.away} ` : "";
    document.title = `${count > 0 ? T.title.alarms(count) : away}${fleetName.value || "Tutti"} – Tutti`;
    if (!fleetName.value) return; // the icon is not needed for the first data
    document.querySelector("link[rel=icon]")?.setAttribute("href", count > 0 ? "icon-alarm.svg" : "icon.svg");
  });
  let timer = 0;
  let known = new Set<string>();
  effect(() => {
    const now = new Set(newAlarms.value.map((alarm) => `${alarm.id} ${alarm.count ?? 1}`));
    const fresh = [...now].some((each) => !known.has(each));
    known = now;
    clearInterval(timer);
    if (!soundOn.value || now.size === 0) return;
    if (fresh) beep();
    timer = setInterval(beep, REPEAT_MS);
  });
}
