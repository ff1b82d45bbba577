/** Manual control of axes by this page: hold-to-run jogs, and one-step works that a person waits for. */

import { computed, signal } from "@preact/signals";
import type { Refusal, Work } from "./model.ts";
import { accept, showNote, showRefusal } from "./notices.ts";
import { ask, listen, send, takeId } from "./stream.ts";
import * as T from "../texts.ts";

const RENEW_MS = 100;
const FRESH_MS = 200; // an answer older than this is no sign that the gateway still passes jogs on
const GIVE_UP_MS = 600;
const ALIVE_MS = 300;
const IDLE_MS = 3000; // without motion, until the axis is released

/** The axes that this page holds. */
export const held = signal<string[]>([]);
/** The jog that a pointer or a key holds. */
export const jogging = signal<{ axis: string; direction: number } | null>(null);
/** The running work, in words. */
export const working = signal<{ words: string; axes: string[]; fraction: number | null; job?: string } | null>(null);
/** Steps that follow the running one, as soon as it is done. */
let further: object[] = [];
/** Why the view cannot be changed now. */
export const isBusy = computed(() => jogging.value !== null || working.value !== null || held.value.length > 0);

export interface Press {
  readonly axis: string;
  velocity: number;
  /** The velocity that the gateway has been asked for. */
  sent: number;
  /** Called before each renewal; it may end the jog. */
  readonly look: (() => void) | undefined;
  asked: boolean;
  answeredMs: number | null;
  askedMs: number;
}

let press: Press | null = null;
let renewTimer = 0;
let aliveTimer = 0;
let idleTimer = 0;
let workId = 0;

/**
 * A pointer or a key has been pressed: jog `axis` at `velocity` (unit/s, never 0) until `endJog`. Null: it cannot begin.
 *
 * `look`: called before each renewal, for what does not end by an event; it may end the jog.
 */
export function beginJog(axis: string, velocity: number, look?: () => void): Press | null {
  endJog();
  if (velocity === 0 || working.value !== null) return null;
  clearTimeout(idleTimer);
  const mine: Press = { axis, velocity, sent: velocity, look, asked: false, answeredMs: null, askedMs: performance.now() };
  press = mine;
  jogging.value = { axis, direction: Math.sign(velocity) };
  if (held.value.includes(axis)) {
    requestJog(mine);
    return mine;
  }
  if (held.value.length > 0) release();
  keepAlive();
  void ask({ do: "acquire", axes: [axis] }).then((answer) => {
    if ("refused" in answer) {
      if (press === mine) forgetPress();
      showRefusal(T.jog.refused(axis), answer.refused);
      return;
    }
    const axes = answer.ok["axes"];
    held.value = Array.isArray(axes) ? axes.map(String) : [axis];
    keepAlive();
    if (press === mine) requestJog(mine);
    else waitIdle();
  });
  return mine;
}

export function isPressed(mine: Press): boolean {
  return press === mine;
}

/** Another velocity (unit/s) in the same direction: it goes with the next renewal, and so begins nothing that has ended. */
export function changeJog(mine: Press, velocity: number): void {
  if (velocity * mine.velocity > 0) mine.velocity = velocity;
}

/** The pointer or the key has been let go: one frame, at once. */
export function endJog(): void {
  const mine = press;
  if (mine === null) return;
  if (mine.asked) send(END_JOG);
  forgetPress();
}

const END_JOG = { do: "end-jog" };

function requestJog(mine: Press): void {
  mine.asked = true;
  mine.askedMs = performance.now();
  mine.sent = mine.velocity;
  void ask({ do: "jog", axis: mine.axis, velocity: mine.velocity }).then((answer) => noteAnswer(mine, answer));
  clearInterval(renewTimer);
  renewTimer = setInterval(() => renew(mine), RENEW_MS);
}

function renew(mine: Press): void {
  mine.look?.();
  if (press !== mine) return clearInterval(renewTimer);
  const now = performance.now();
  const silent = now - (mine.answeredMs ?? mine.askedMs);
  if (mine.answeredMs !== null && silent < FRESH_MS) {
    const frame = mine.velocity === mine.sent ? { do: "renew" } : { do: "renew", velocity: mine.velocity };
    mine.sent = mine.velocity;
    void ask(frame).then((answer) => noteAnswer(mine, answer));
  } else if (silent > GIVE_UP_MS) {
    endJog();
    showNote(T.jog.ended(mine.axis), T.jog.noAnswer);
  }
}

function noteAnswer(mine: Press, answer: { ok: unknown } | { refused: Refusal }): void {
  if (press !== mine) return;
  if ("ok" in answer) {
    mine.answeredMs = performance.now();
    return;
  }
  endJog();
  showRefusal(T.jog.refused(mine.axis), answer.refused);
}

function forgetPress(): void {
  clearInterval(renewTimer);
  press = null;
  jogging.value = null;
  waitIdle();
}

function waitIdle(): void {
  clearTimeout(idleTimer);
  idleTimer = setTimeout(() => {
    if (press === null && held.value.length > 0) release();
  }, IDLE_MS);
}

/** Give the axes back. */
export function release(): void {
  held.value = [];
  void ask({ do: "release" });
}

/** Begin a one-step job, or several one after the other. They end with the socket, or by `cancelWork`. */
export async function beginWork(words: string, axes: string[], step: object | object[]): Promise<boolean> {
  endJog();
  if (working.value !== null) {
    showNote(T.work.busy(working.value.words), T.work.busyRemedy);
    return false;
  }
  if (held.value.length > 0) release();
  const [first, ...rest] = Array.isArray(step) ? (step as object[]) : [step];
  if (first === undefined) return false;
  further = rest;
  return requestWork(words, axes, first);
}

async function requestWork(words: string, axes: string[], step: object): Promise<boolean> {
  working.value = { words, axes, fraction: null };
  keepAlive();
  const id = takeId();
  workId = id;
  if (accept(words, await ask({ do: "work", step }, id)) !== null) return true;
  if (workId === id) {
    working.value = null;
    further = [];
  }
  return false;
}

export function cancelWork(): void {
  further = [];
  if (working.value !== null) void ask({ do: "cancel-work" });
}

const ENDED = new Set(["done", "failed", "cancelled", "aborted", "interrupted", "refused"]);

function takeWork(work: Work): void {
  const now = working.value;
  if (now === null || work.id !== workId) return; // an earlier work may end late
  if (!ENDED.has(work.state)) {
    working.value = { ...now, fraction: work.fraction ?? now.fraction, ...(work.job_id ? { job: work.job_id } : {}) };
    return;
  }
  const [next, ...rest] = work.state === "done" ? further : [];
  further = rest;
  if (next !== undefined) return void requestWork(now.words, now.axes, next);
  working.value = null;
  if (work.state === "done") return;
  showRefusal(now.words, { code: work.state, text: work.reason || T.work.ended(work.state), remedy: work.remedy ?? "" });
}

/** The gateway keeps the lease only while the page sends something each second. */
function keepAlive(): void {
  if (aliveTimer !== 0) return;
  aliveTimer = setInterval(() => {
    if (!isBusy.value) {
      clearInterval(aliveTimer);
      aliveTimer = 0;
    } else send({ do: "alive" });
  }, ALIVE_MS);
}

listen({
  onManual(axes, lost) {
    held.value = axes;
    if (axes.length > 0) {
      keepAlive();
      if (press === null) waitIdle();
    } else if (lost) {
      endJog();
      showRefusal(T.jog.lost, lost);
    }
  },
  onJogRefused(axis, refusal) {
    endJog();
    showRefusal(T.jog.refused(axis), refusal);
  },
  onWork: takeWork,
  onClosed() {
    const moved = press;
    endJog();
    held.value = [];
    if (moved !== null) showNote(T.jog.ended(moved.axis), T.jog.socketClosed);
    if (working.value !== null) showNote(working.value.words, T.work.socketClosed);
    working.value = null;
    further = [];
  },
});

/** Whatever takes the pointer or the keyboard away from this page ends a jog. */
export function watchPage(): void {
  window.addEventListener("blur", endJog);
  window.addEventListener("pagehide", endJog);
  document.addEventListener("freeze", endJog);
  document.addEventListener("visibilitychange", () => {
    if (document.visibilityState !== "visible") endJog();
  });
}
