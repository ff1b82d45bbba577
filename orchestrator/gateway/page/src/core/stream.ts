/** The socket to the gateway: frames in, frames and their answers out, and how old what is shown is. */

import { computed, effect, signal, untracked } from "@preact/signals";
import type { Answer, Refusal, Session, State, Stopped, Work } from "./model.ts";
import type { JsonObject } from "./patch.ts";
import { counts, MANY, takePatch, takeSnapshot } from "./store.ts";
import * as T from "../texts.ts";

const FIRST_PAUSE_MS = 200;
const LONGEST_PAUSE_MS = 3000;
const SILENT_MS = 4000; // the gateway sends at least twice a second: such a socket is dead, and is opened anew
const STALE_MS = 1000;

export type Connection = "connecting" | "open" | "lost" | "signed-out";

export const connection = signal<Connection>("connecting");
export const session = signal<Session | null>(null);
/** Whole seconds since the last frame; 0 while what is shown is fresh. By this page's own clock, never by the date. */
export const pageAge = signal(0);
export const isStale = computed(() => pageAge.value > 0);

/** The parts of the state that the page needs; null: all. */
export const need = signal<string[] | null>(null);

interface Frame {
  hello?: Session;
  n?: number;
  state?: State;
  patch?: JsonObject;
  answer?: number;
  ok?: Record<string, unknown>;
  refused?: Refusal;
  manual?: { axes: string[]; lost?: Refusal | null };
  jog?: { axis: string; refused: Refusal };
  work?: Work;
  stopped?: Stopped;
}

/** What parts of the page receive besides the state. */
export interface Listener {
  onManual?(axes: string[], lost: Refusal | null): void;
  onJogRefused?(axis: string, refusal: Refusal): void;
  onWork?(work: Work): void;
  onStopped?(stopped: Stopped): void;
  onClosed?(): void;
}

const listeners: Listener[] = [];
const waiting = new Map<number, (answer: Answer) => void>();
let socket: WebSocket | null = null;
let greeted = false;
let lastId = 0;
let lastNumber: number | null = null;
let lastFrameMs = performance.now();
let pauseMs = FIRST_PAUSE_MS;
let timer = 0;
let started = false;
/** For benches: how many snapshots and patches have been taken. */
export let updates = 0;

export function listen(listener: Listener): void {
  listeners.push(listener);
}

/** Begin to connect, and go on for ever. */
export function start(): void {
  if (started) return;
  started = true;
  connect();
  effect(() => {
    const items = need.value;
    if (isOpen()) socket?.send(JSON.stringify({ do: "need", ...(items && { need: items }) }));
  });
  setInterval(checkAge, 100);
  document.addEventListener("visibilitychange", checkAge);
}

/** Connect again at once, for example with another user. */
export function reconnect(): void {
  pauseMs = FIRST_PAUSE_MS;
  if (socket !== null) socket.close();
  else connect();
}

export function isOpen(): boolean {
  return socket !== null && socket.readyState === WebSocket.OPEN && greeted;
}

/** Send one frame now. False: the socket is not open. */
export function send(frame: object): boolean {
  if (!isOpen() || socket === null) return false;
  socket.send(JSON.stringify(frame));
  return true;
}

/** A new number for a frame. */
export function takeId(): number {
  lastId += 1;
  return lastId;
}

/** Send a frame that is answered. It is on its way when this returns; the answer comes later. */
export function ask(frame: object, id = takeId()): Promise<Answer> {
  if (!send({ id, ...frame })) return Promise.resolve({ refused: noConnection() });
  return new Promise((resolve) => waiting.set(id, resolve));
}

export function noConnection(): Refusal {
  return { code: "no-connection", text: T.refusal.noConnection, remedy: T.refusal.noConnectionRemedy };
}

function connect(): void {
  clearTimeout(timer);
  const address = new URL("v1/stream", location.href);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  address.hash = "";
  address.search = need.peek() === null ? `most=${MANY}` : `need=${need.peek()}`;
  if (connection.value !== "lost") connection.value = "connecting";
  const mine = new WebSocket(address);
  socket = mine;
  greeted = false;
  mine.onmessage = (event: MessageEvent<unknown>) => {
    if (socket === mine && typeof event.data === "string") handleFrame(event.data);
  };
  mine.onclose = () => {
    if (socket === mine) handleClosed();
  };
}

/** Handle one frame, from the socket or from a bench. */
export function handleFrame(text: string): void {
  let frame: Frame;
  try {
    frame = JSON.parse(text) as Frame;
  } catch {
    return; // it counts as no sign of life
  }
  const now = performance.now();
  lastFrameMs = now;
  if (pageAge.peek() !== 0) pageAge.value = 0;
  if (frame.n !== undefined) return handleState(frame, frame.n, now);
  if (frame.answer !== undefined) {
    const resolve = waiting.get(frame.answer);
    waiting.delete(frame.answer);
    resolve?.(frame.refused ? { refused: frame.refused } : { ok: frame.ok ?? {} });
  } else if (frame.hello !== undefined) {
    greeted = true;
    pauseMs = FIRST_PAUSE_MS;
    lastNumber = null;
    session.value = frame.hello;
    connection.value = "open";
  } else {
    for (const each of listeners) {
      if (frame.manual) each.onManual?.(frame.manual.axes, frame.manual.lost ?? null);
      if (frame.jog) each.onJogRefused?.(frame.jog.axis, frame.jog.refused);
      if (frame.work) each.onWork?.(frame.work);
      if (frame.stopped) each.onStopped?.(frame.stopped);
    }
  }
}

function handleState(frame: Frame, number: number, now: number): void {
  const known = frame.state?.counts;
  if (known && need.peek() === null && known.controllers > MANY) {
    lastNumber = null; // without them: the page says which it needs, by these counts, and the next state has those
    counts.value = known;
  } else if (frame.state !== undefined) {
    lastNumber = number;
    updates += 1;
    takeSnapshot(frame.state, now);
  } else if (lastNumber === null || number !== lastNumber + 1) {
    if (lastNumber !== null) send({ do: "resync" }); // one request: until the snapshot comes, patches are ignored
    lastNumber = null;
  } else if (frame.patch !== undefined) {
    lastNumber = number;
    updates += 1;
    takePatch(frame.patch, now);
  }
}

function handleClosed(): void {
  const refusedAtOnce = !greeted;
  socket = null;
  greeted = false;
  for (const each of listeners) each.onClosed?.();
  for (const resolve of waiting.values()) resolve({ refused: noConnection() });
  waiting.clear();
  if (connection.value === "open") connection.value = "lost";
  if (refusedAtOnce) void askForSession();
  else retryLater();
}

/** The socket does not say why it was refused; the session does. A fleet whose last user was removed needs no sign-in
 * any more: it is asked again. */
async function askForSession(): Promise<void> {
  try {
    const answer = await fetch("v1/session", { headers: { Accept: "application/json" } });
    if (socket !== null) return; // signed in meanwhile
    if (answer.status === 401) {
      session.value = null;
      connection.value = "signed-out";
      timer = setTimeout(askForSession, LONGEST_PAUSE_MS);
      return;
    }
  } catch {
    // the gateway is away
  }
  retryLater();
}

function retryLater(): void {
  if (connection.value === "connecting") connection.value = "lost";
  clearTimeout(timer);
  timer = setTimeout(connect, pauseMs);
  pauseMs = Math.min(LONGEST_PAUSE_MS, pauseMs * 1.7);
}

function checkAge(): void {
  const age = performance.now() - lastFrameMs;
  pageAge.value = age > STALE_MS ? Math.floor(age / 1000) : 0;
  if (age > SILENT_MS && isOpen() && socket !== null) {
    const dead = socket;
    dead.onclose = null; // closing a dead connection may take long: what depends on it ends now
    dead.close();
    handleClosed();
  }
}

/** Run `action` whenever the connection has been opened with a session. */
export function whenOpen(action: () => void): void {
  effect(() => {
    if (connection.value === "open") untracked(action);
  });
}
