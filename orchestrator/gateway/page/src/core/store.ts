/**
 * The state of the fleet as signals, one for each thing that changes by itself.
 *
 * A position changes twenty times a second: it has a signal of its own, bound to one text, so an update renders nothing
 * else again. The state itself is kept plain, and frames are merged into it.
 */

import { batch, computed, signal, type Signal } from "@preact/signals";
import type {
  Alarm,
  AxisState,
  ClockQuality,
  ControllerState,
  Counts,
  FleetEvent,
  JobProgress,
  LastStop,
  Lease,
  LinkTotals,
  Members,
  Permit,
  QueueState,
  State,
  WebView,
} from "./model.ts";
import { isObject, mergePatch, type Json, type JsonObject } from "./patch.ts";
import { Ring } from "./ring.ts";

const SAMPLE_MS = 100;
const SAMPLES = 900; // 90 s at 10 Hz

/** What changes all the time in an axis; a row is rendered again only when something else does. */
const FAST = ["position", "commanded", "velocity", "target"] as const;
type Fast = (typeof FAST)[number];

export class AxisStore {
  readonly id: string;
  readonly position: Signal<number | null> = signal(null);
  readonly commanded: Signal<number | null> = signal(null);
  readonly velocity: Signal<number | null> = signal(null);
  readonly target: Signal<number | null> = signal(null);
  readonly flags: Signal<AxisState>;
  readonly ring = new Ring(SAMPLES);

  constructor(
    readonly controller: string,
    readonly name: string,
    state: AxisState,
  ) {
    this.id = `${controller}.${name}`;
    this.flags = signal(state);
    this.take(state, null);
  }

  /** Take the state; `changed`: the names of its changed fields, null for all. */
  take(state: AxisState, changed: string[] | null): void {
    let slow = changed === null;
    for (const key of changed ?? FAST) {
      if (isFast(key)) {
        const before = this[key].peek();
        const now = state[key] ?? null;
        this[key].value = now;
        if ((before === null) !== (now === null)) slow = true; // a row without a target looks different
      } else slow = true;
    }
    if (slow) this.flags.value = state;
  }
}

function isFast(key: string): key is Fast {
  return (FAST as readonly string[]).includes(key);
}

export type ControllerRest = Omit<ControllerState, "axes" | "clock" | "link" | "age_s">;

const OWN_SIGNALS = ["axes", "clock", "link", "age_s"];

export class ControllerStore {
  readonly rest: Signal<ControllerRest>;
  readonly clock: Signal<ClockQuality | undefined>;
  readonly link: Signal<LinkTotals | undefined>;
  readonly age: Signal<number>;
  readonly axes: Signal<AxisStore[]> = signal([]);
  private readonly byName = new Map<string, AxisStore>();

  constructor(
    readonly id: string,
    state: ControllerState,
  ) {
    this.rest = signal(state);
    this.clock = signal(state.clock);
    this.link = signal(state.link);
    this.age = signal(state.age_s ?? 0);
    this.takeAxes(state.axes, null);
  }

  take(state: ControllerState, patch: JsonObject | null): void {
    const keys = patch === null ? null : Object.keys(patch);
    if (keys === null || keys.some((key) => !OWN_SIGNALS.includes(key))) this.rest.value = state;
    this.clock.value = state.clock;
    this.link.value = state.link;
    this.age.value = state.age_s ?? 0;
    if (patch === null) this.takeAxes(state.axes, null);
    else if (patch["axes"] !== undefined) this.takeAxes(state.axes, isObject(patch["axes"]) ? patch["axes"] : null);
  }

  private takeAxes(axes: Record<string, AxisState>, patch: JsonObject | null): void {
    let listed = false;
    for (const name of Object.keys(patch ?? axes)) {
      const state = axes[name];
      const known = this.byName.get(name);
      if (state === undefined) {
        listed = this.byName.delete(name) || listed;
      } else if (known === undefined) {
        this.byName.set(name, new AxisStore(this.id, name, state));
        listed = true;
      } else {
        const change = patch?.[name];
        known.take(state, isObject(change) ? Object.keys(change) : null);
      }
    }
    if (patch === null)
      for (const name of this.byName.keys())
        if (axes[name] === undefined) listed = this.byName.delete(name) || listed;
    if (listed) this.axes.value = [...this.byName.values()];
  }
}

export const fleetName = signal("");
export const utc = signal("");
export const fleetSeconds = signal<number | null>(null);
export const coordinator = signal<State["coordinator"]>({ present: false });
export const controllers = signal<ControllerStore[]>([]);
/** Groups of virtual axes, with what a controller has as far as they have it. */
export const groups = signal<ControllerStore[]>([]);
/** What has axes. */
export const owners = computed(() => [...controllers.value, ...groups.value]);
export const counts = signal<Counts | undefined>(undefined);
/** Of more controllers than this the page shows some at a time. */
export const MANY = 60;
export const leases = signal<Record<string, Lease>>({});
export const permits = signal<Permit[]>([]);
export const queue = signal<QueueState>({});
export const jobs = signal<Record<string, JobProgress>>({});
export const paths = signal<Record<string, { step: number; axes: string[] }>>({});
export const members = signal<Record<string, Members>>({});
export const alarms = signal<Record<string, Alarm>>({});
export const events = signal<FleetEvent[]>([]);
export const lastStop = signal<LastStop | undefined>(undefined);
export const views = signal<WebView[]>([]);
/** Whether a snapshot has come. */
export const loaded = signal(false);
/** Increases when new samples are in the rings. */
export const samples = signal(0);

const stores = new Map<string, ControllerStore>();
const groupStores = new Map<string, ControllerStore>();
let state: State | null = null;
let sampledMs = -Infinity;

export function findController(id: string): ControllerStore | undefined {
  return stores.get(id) ?? groupStores.get(id);
}

/** What renders by it is rendered again once the axis is there: a remembered choice comes before the state. */
export function findAxis(id: string): AxisStore | undefined {
  const [owner = "", name = ""] = id.split(".");
  const controller = owners.value.find((each) => each.id === owner);
  return controller?.axes.value.find((axis) => axis.name === name);
}

export function realAxes(): AxisStore[] {
  return controllers.value.flatMap((controller) => controller.axes.value);
}

/** Virtual axes come behind the real ones. */
export function allAxes(): AxisStore[] {
  return owners.value.flatMap((owner) => owner.axes.value);
}

/** Replace the whole state. `nowMs`: when it came, on this page's own clock. */
export function takeSnapshot(snapshot: State, nowMs: number): void {
  state = snapshot;
  publish(null, nowMs);
}

/** Merge a patch into the state. */
export function takePatch(patch: JsonObject, nowMs: number): void {
  if (state === null) return;
  state = mergePatch(state as unknown as Json, patch) as unknown as State;
  publish(patch, nowMs);
}

function publish(patch: JsonObject | null, nowMs: number): void {
  const now = state;
  if (now === null) return;
  batch(() => {
    loaded.value = true;
    // A signal that gets the object it has already notifies nothing.
    fleetName.value = now.fleet;
    utc.value = now.utc;
    fleetSeconds.value = now.fleet_s ?? null;
    coordinator.value = now.coordinator ?? NO_COORDINATOR;
    counts.value = now.counts;
    leases.value = now.leases ?? NOTHING;
    permits.value = now.permits ?? NO_LIST;
    queue.value = now.queue ?? NOTHING;
    jobs.value = now.jobs ?? NOTHING;
    paths.value = now.paths ?? NOTHING;
    members.value = now.members ?? NOTHING;
    alarms.value = now.alarms ?? NOTHING;
    events.value = now.events ?? NO_LIST;
    lastStop.value = now.last_stop;
    views.value = now.views ?? NO_LIST;
    takeOwners(now.controllers, patch === null ? null : patch["controllers"], stores, controllers);
    takeOwners(now.virtual, patch === null ? null : patch["virtual"], groupStores, groups);
    takeSamples(nowMs);
  });
}

const NOTHING: Record<string, never> = {};
const NO_LIST: never[] = [];
const NO_COORDINATOR = { present: false };

/** Take what has changed of `all`. change: their part of a patch; undefined: nothing. */
function takeOwners(
  all: Record<string, ControllerState> = {},
  change: Json | undefined,
  stores: Map<string, ControllerStore>,
  list: Signal<ControllerStore[]>,
): void {
  if (change === undefined) return;
  const patch = isObject(change) ? change : null;
  let listed = false;
  for (const id of Object.keys(patch ?? all)) {
    const next = all[id];
    const known = stores.get(id);
    if (next === undefined) {
      listed = stores.delete(id) || listed;
    } else if (known === undefined) {
      stores.set(id, new ControllerStore(id, next));
      listed = true;
    } else {
      const part = patch?.[id];
      known.take(next, isObject(part) ? part : null);
    }
  }
  if (patch === null)
    for (const id of stores.keys()) if (all[id] === undefined) listed = stores.delete(id) || listed;
  if (listed) list.value = [...stores.values()];
}

function takeSamples(nowMs: number): void {
  if (nowMs - sampledMs < SAMPLE_MS) return;
  sampledMs = nowMs;
  for (const owner of owners.peek())
    for (const axis of owner.axes.peek()) {
      const position = axis.position.peek();
      if (position !== null) axis.ring.push(nowMs / 1000, position);
    }
  samples.value += 1;
}
