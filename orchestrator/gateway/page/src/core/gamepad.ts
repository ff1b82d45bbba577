/**
 * Jogs by a gamepad: a dead-man button is held, a stick chooses axis, direction and speed.
 *
 * Whatever ends a jog other than the stick takes the enabling away: the dead-man button has to be let go, and pressed again
 * with the stick at its centre. The pad is read in every renewal, so that nothing is renewed by an old reading.
 */

import { signal } from "@preact/signals";
import { openCount } from "./keys.ts";
import { beginJog, changeJog, endJog, isPressed, jogging, type Press } from "./manual.ts";
import { showNote } from "./notices.ts";
import { isFlag, remembered } from "./remember.ts";
import * as T from "../texts.ts";

const POLL_MS = 20;
/** Parts of the deflection, in steps that are worth a new velocity. */
const STEPS = 20;
export const DEAD_ZONES = [0.1, 0.15, 0.2, 0.3];
export const MOST_INPUTS = 32;

export type Way = "across" | "upwards";
const WAYS: Way[] = ["across", "upwards"];

const isIndex = (value: unknown): value is number => Number.isInteger(value) && Number(value) >= 0 && Number(value) < MOST_INPUTS;
const isDeadZone = (value: unknown): value is number => DEAD_ZONES.includes(value as number);

/** Which axis of the pad moves, whether it is reversed, and which button is held. The choice is kept, that it is on is not. */
export const sticks = { across: remembered("pad.across", 0, isIndex), upwards: remembered("pad.upwards", 1, isIndex) };
/** Up is negative on most sticks. */
export const reversed = { across: remembered("pad.across.reversed", false, isFlag), upwards: remembered("pad.upwards.reversed", true, isFlag) };
export const deadMan = remembered("pad.button", 4, isIndex);
export const deadZone = remembered("pad.deadzone", 0.15, isDeadZone);

/** What the pad shows now. parts: from -1 to 1 beyond the dead zone; 0: at the centre. */
export interface PadReading {
  name: string;
  axes: number;
  buttons: number;
  held: boolean;
  /** The button with the lowest number that is pressed. */
  pressed: number | null;
  parts: Record<Way, number>;
}

/** An axis that a stick moves. */
export interface Drive {
  axis: string;
  /** In unit/s at this part of the deflection. */
  velocity(part: number): number;
  whyNot(): string;
}

export const padOn = signal(false);
export const reading = signal<PadReading | null>(null);
/** Whether a deflection moves an axis now. */
export const isArmed = signal(false);

let drives: Partial<Record<Way, Drive>> = {};
let timer = 0;
let wasHeld = true;
let mine: { press: Press; way: Way } | null = null;

export const hasGamepads = (): boolean => typeof navigator.getGamepads === "function";

function findPad(): Gamepad | null {
  return hasGamepads() ? ([...navigator.getGamepads()].find((pad) => pad?.connected) ?? null) : null;
}

/** The part of a deflection beyond the dead zone, in steps. What is no number is the centre. */
function partOf(value: number | undefined, isReversed: boolean): number {
  if (value === undefined || !Number.isFinite(value)) return 0;
  const beyond = (Math.min(1, Math.abs(value)) - deadZone.value) / (1 - deadZone.value);
  if (beyond <= 0) return 0;
  return (Math.max(1, Math.round(beyond * STEPS)) / STEPS) * Math.sign(value) * (isReversed ? -1 : 1);
}

function readPad(pad: Gamepad): PadReading {
  const part = (way: Way): number => partOf(pad.axes[sticks[way].value], reversed[way].value);
  const pressed = pad.buttons.findIndex((button) => button.pressed);
  return {
    name: pad.id,
    axes: pad.axes.length,
    buttons: pad.buttons.length,
    held: pad.buttons[deadMan.value]?.pressed ?? false,
    pressed: pressed < 0 ? null : pressed,
    parts: { across: part("across"), upwards: part("upwards") },
  };
}

/** The axes that the sticks move from now on. */
export function setDrives(next: Partial<Record<Way, Drive>>): void {
  drives = next;
}

export function switchOn(): void {
  if (padOn.value) return;
  padOn.value = true;
  wasHeld = true; // a button that is held already has not been pressed for this
  isArmed.value = false;
  timer = setInterval(look, POLL_MS);
  look();
}

export function switchOff(): void {
  clearInterval(timer);
  end();
  isArmed.value = false;
  padOn.value = false;
  reading.value = null;
}

function end(): void {
  const ended = mine;
  mine = null;
  if (ended !== null && isPressed(ended.press)) endJog();
}

/** Read the pad, and do what it says. */
function look(): void {
  const pad = findPad();
  const before = reading.value;
  if (pad === null) {
    if (before === null) return; // none has been there yet
    switchOff();
    return showNote(T.pad.lost(before.name), T.pad.lostRemedy);
  }
  const now = readPad(pad);
  if (JSON.stringify(now) !== JSON.stringify(before)) reading.value = now;
  const isAttended = document.hasFocus() && document.visibilityState === "visible" && openCount.value === 0;
  const isCentred = WAYS.every((way) => now.parts[way] === 0);
  if (!now.held || !isAttended) isArmed.value = false;
  else if (!wasHeld && isCentred) isArmed.value = true;
  wasHeld = now.held;
  if (isArmed.value) steer(now);
  else end();
}

function steer({ parts }: PadReading): void {
  if (mine !== null) {
    if (!isPressed(mine.press)) {
      mine = null; // by a stop, a refusal, a pointer, a silent gateway
      isArmed.value = false;
      return;
    }
    const part = parts[mine.way];
    const drive = drives[mine.way];
    if (drive?.axis !== mine.press.axis || part * mine.press.velocity <= 0) end();
    else changeJog(mine.press, drive.velocity(part));
    return;
  }
  const way: Way = Math.abs(parts.upwards) > Math.abs(parts.across) ? "upwards" : "across";
  const drive = drives[way];
  if (parts[way] === 0 || drive === undefined) return;
  const why = jogging.value === null ? drive.whyNot() : T.pad.otherJog;
  const press = why ? null : beginJog(drive.axis, drive.velocity(parts[way]), look);
  if (press !== null) {
    mine = { press, way };
    return;
  }
  isArmed.value = false;
  showNote(T.why.cannot(T.jog.name(drive.axis)), why || T.pad.again);
}

/** A pad that is taken away ends its jog in the event itself. */
export function watchPads(): void {
  const see = (): void => {
    if (padOn.value) look();
  };
  window.addEventListener("gamepaddisconnected", see);
  window.addEventListener("gamepadconnected", see);
  window.addEventListener("blur", see);
  document.addEventListener("visibilitychange", see);
}
