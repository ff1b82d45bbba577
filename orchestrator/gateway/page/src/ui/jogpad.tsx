/**
 * The jog pad: hold to run, or one step for each press, with pointer or arrow keys.
 *
 * Buttons react to pointers only: neither a click nor the space bar begins a motion. Every way to lose the pointer or the
 * keyboard ends it, in the event handler itself.
 */

import type { JSX } from "preact";
import { computed, signal } from "@preact/signals";
import { useEffect, useMemo, useRef } from "preact/hooks";
import { formatQuantity, formatUnit, formatValue, percent, plainNumber } from "../core/format.ts";
import { FINISHED } from "../core/lastreport.ts";
import { whyBeyond } from "../core/limits.ts";
import { isMany, keepers } from "../core/many.ts";
import { isNumber, isText, remembered } from "../core/remember.ts";
import { beginJog, beginWork, cancelWork, endJog, held, jogging, release, working } from "../core/manual.ts";
import { showNote } from "../core/notices.ts";
import { readinessOf } from "../core/ready.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import { allAxes, findAxis, findController, jobs, leases, permits, queue, type AxisStore } from "../core/store.ts";
import { pageAge } from "../core/stream.ts";
import * as T from "../texts.ts";
import { holderOf } from "./axes.tsx";
import { type AxisDrive, GamepadForm } from "./gamepad.tsx";
import { Act, Empty, Mark, Panel, Progress } from "./parts.tsx";
import { askRelease } from "./start.tsx";

const FRACTIONS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1];
export const STEPS = [0.001, 0.01, 0.1, 1, 10, 100];

export const across = remembered("jog.across", "", isText);
export const upwards = remembered("jog.upwards", "", isText);
keepers.push(() => [across.value, upwards.value]);
const speed = remembered("jog.speed", 0.2, isNumber);
/** The step in the axis's unit; 0: hold to run. */
const stepSize = remembered("jog.step", 0, isNumber);

/** Where a press has begun, so that its end can be told from others'. */
const pressed = signal<string | null>(null);

/** The fastest jog of an axis now, unit/s: slow until it is referenced. */
function jogSpeed(axis: AxisStore): number {
  const flags = axis.flags.value;
  if (flags.jog_velocity !== undefined) return flags.jog_velocity;
  const most = flags.max_velocity ?? 1;
  return flags.referenced ? most / 4 : most / 50;
}

/** An axis of a running job is not for jogging; whether another user has it, the gateway knows best. */
function whyHeld(axis: AxisStore): string {
  const holder = (leases.value[axis.id] ?? leases.value[axis.controller])?.holder;
  const job = holder ? jobs.value[holder] : undefined;
  return job && !FINISHED.has(job.state) ? T.why.held(axis.id, job.name) : "";
}

function whyNotJog(axis: AxisStore): string {
  const flags = axis.flags.value;
  return firstOf(
    whyNot("jog", axis.controller),
    working.value ? T.why.working(working.value.words) : "",
    whyHeld(axis),
    flags.enabled ? "" : T.why.disabled(axis.id),
    flags.jog_velocity === 0 ? T.why.noJog(axis.id) : "",
  );
}

/** An axis of the pad for a stick of a gamepad; full deflection is the chosen speed. */
function makeDrive(axis: AxisStore): AxisDrive {
  return {
    axis: axis.id,
    velocity: (part) => part * speed.value * jogSpeed(axis),
    whyNot: () => whyNotJog(axis),
    show: (part) => `${formatQuantity(part * speed.value * jogSpeed(axis), axis.flags.value.unit)}/s`,
  };
}

function press(source: string, axis: AxisStore, direction: number): void {
  const why = whyNotJog(axis);
  if (why) return showNote(T.why.cannot(T.jog.name(axis.id)), why);
  pressed.value = source;
  if (stepSize.value === 0) {
    beginJog(axis.id, direction * speed.value * jogSpeed(axis));
    return;
  }
  const beyond = whyBeyond(axis, axis.position.value === null ? null : axis.position.value + direction * stepSize.value);
  if (beyond && axis.flags.value.referenced) return showNote(T.why.cannot(T.jog.name(axis.id)), beyond);
  const words = T.jog.step(axis.id, formatQuantity(direction * stepSize.value, axis.flags.value.unit));
  const limit = axis.flags.value.max_velocity;
  const fraction = limit ? Math.min(1, (speed.value * jogSpeed(axis)) / limit) : speed.value;
  void beginWork(words, [axis.id], {
    do: "move",
    by: { [axis.id]: Number(plainNumber(direction * stepSize.value)) },
    speed: Number(fraction.toPrecision(4)),
  });
}

function letGo(source?: string): void {
  if (source !== undefined && pressed.peek() !== source) return;
  endJog();
  pressed.value = null;
}

function HoldButton({ axis, direction, sign, place }: { axis: AxisStore; direction: number; sign: string; place: string }): JSX.Element {
  const source = `${axis.id}${direction}`;
  const end = (): void => letGo(source);
  const runs = jogging.value?.axis === axis.id && jogging.value.direction === direction;
  const why = whyNotJog(axis);
  return (
    <button
      type="button"
      tabIndex={-1}
      class={`hold ${place} ${runs ? "runs" : ""}`}
      aria-label={direction > 0 ? T.jog.plus(axis.id) : T.jog.minus(axis.id)}
      aria-disabled={why ? "true" : undefined}
      aria-description={why || undefined}
      title={why || undefined}
      onPointerDown={(event) => {
        if (event.button !== 0 || !event.isPrimary) return;
        event.preventDefault(); // no selection, no drag; the pad gets the focus, so that the arrow keys go on
        event.currentTarget.closest<HTMLElement>(".pad")?.focus({ preventScroll: true });
        event.currentTarget.setPointerCapture(event.pointerId);
        press(source, axis, direction);
      }}
      onPointerUp={end}
      onPointerCancel={end}
      onLostPointerCapture={end}
      onContextMenu={(event) => event.preventDefault()}
    >
      <span aria-hidden="true">{sign}</span>
    </button>
  );
}

const ARROWS: Record<string, ["across" | "upwards", number]> = {
  ArrowLeft: ["across", -1],
  ArrowRight: ["across", 1],
  ArrowDown: ["upwards", -1],
  ArrowUp: ["upwards", 1],
};

function onKeyDown(event: KeyboardEvent): void {
  if (event.target !== event.currentTarget) return;
  const arrow = ARROWS[event.key];
  if (event.key === " ") return event.preventDefault(); // it neither scrolls nor moves anything
  if (arrow === undefined) {
    if (event.key === "+" || event.key === "=") changeSpeed(1);
    else if (event.key === "-") changeSpeed(-1);
    return;
  }
  event.preventDefault();
  if (event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
  const axis = chosenAxes.value[arrow[0]];
  if (axis) press(event.key, axis, arrow[1]);
}

function onKeyUp(event: KeyboardEvent): void {
  if (event.key in ARROWS) letGo(event.key);
}

function changeSpeed(by: number): void {
  const at = FRACTIONS.indexOf(speed.value);
  speed.value = FRACTIONS[Math.max(0, Math.min(FRACTIONS.length - 1, (at < 0 ? 4 : at) + by))] ?? 0.2;
}

/** The axes of the pad; the first two of the fleet until others are chosen. */
const chosenAxes = computed<{ across?: AxisStore; upwards?: AxisStore }>(() => {
  // Of many those that are shown change: then nothing is chosen but by a person.
  const all = isMany.value ? [] : allAxes();
  const first = findAxis(across.value) ?? all[0];
  const second = upwards.value === NO_AXIS ? undefined : (findAxis(upwards.value) ?? all.find((axis) => axis !== first));
  const chosen: { across?: AxisStore; upwards?: AxisStore } = {};
  if (first) chosen.across = first;
  if (second && second !== first) chosen.upwards = second;
  return chosen;
});
const NO_AXIS = "-";

export function JogPanel(): JSX.Element {
  useEffect(() => () => letGo(), []);
  const { across: first, upwards: second } = chosenAxes.value;
  // One Tab from here reaches the pad.
  const start = useRef<HTMLDivElement>(null);
  useEffect(() => {
    const now = document.activeElement;
    if (now === null || now === document.body || now.closest("nav") !== null) start.current?.focus({ preventScroll: true });
  }, [first === undefined]);
  if (first === undefined) return <Panel title={T.jog.title} children={<Empty text={isMany.value ? T.many.choose : T.axes.none} />} />;
  return (
    <Panel
      title={T.jog.title}
      area="jog"
      tools={held.value.length > 0 ? <Act label={T.jog.release(held.value.join(", "))} kind="small" onAct={release} /> : null}
    >
      <div class="jogstart" tabIndex={-1} ref={start} />
      <div class="jogarea">
        <div
          class="pad"
          role="group"
          tabIndex={0}
          aria-label={T.jog.pad}
          aria-describedby="jog-hint"
          onKeyDown={onKeyDown}
          onKeyUp={onKeyUp}
          onBlur={() => letGo()}
        >
          <HoldButton axis={first} direction={-1} sign="−" place="left" />
          <HoldButton axis={first} direction={1} sign="+" place="right" />
          {second ? <HoldButton axis={second} direction={1} sign="+" place="up" /> : null}
          {second ? <HoldButton axis={second} direction={-1} sign="−" place="down" /> : null}
          <span class="padname across">{first.name}</span>
          {second ? <span class="padname upwards">{second.name}</span> : null}
        </div>
        <div class="readouts">
          <AxisReadout axis={first} />
          {second ? <AxisReadout axis={second} /> : null}
        </div>
      </div>
      <div class="jogselect">
        <AxisSelect label={T.jog.across} value={first.id} onChange={(id) => (across.value = id)} />
        <AxisSelect label={T.jog.upwards} value={second?.id ?? NO_AXIS} none onChange={(id) => (upwards.value = id)} />
      </div>
      <p class="hint" id="jog-hint">
        {stepSize.value === 0 ? T.jog.holdHint : T.jog.stepHint}
      </p>
      <fieldset class="choice">
        <legend>{T.jog.motion}</legend>
        <Act label={T.jog.hold} kind="small" pressed={stepSize.value === 0} onAct={() => (stepSize.value = 0)} />
        {STEPS.map((step) => (
          <Act
            key={step}
            label={`${step} ${formatUnit(first.flags.value.unit)}`}
            kind="small"
            pressed={stepSize.value === step}
            onAct={() => (stepSize.value = step)}
          />
        ))}
      </fieldset>
      <label class="speed">
        <span>
          {T.jog.speed}: <b class="num">{percent(speed.value)}</b> <small>{T.jog.speedNow(formatQuantity(speed.value * jogSpeed(first), first.flags.value.unit))}</small>
        </span>
        <input
          type="range"
          min={0}
          max={FRACTIONS.length - 1}
          value={Math.max(0, FRACTIONS.indexOf(speed.value))}
          aria-valuetext={percent(speed.value)}
          onInput={(event) => (speed.value = FRACTIONS[Number(event.currentTarget.value)] ?? 0.2)}
        />
      </label>
      <GamepadForm across={makeDrive(first)} upwards={second ? makeDrive(second) : undefined} />
      <WorkLine />
    </Panel>
  );
}

export function WorkLine(): JSX.Element | null {
  const work = working.value;
  if (work === null) return null;
  const id = work.job ?? "";
  const ready = jobs.value[id]?.ready ?? queue.value.jobs?.some((job) => job.id === id && job.ready);
  return (
    <div class="work" role="status">
      <span>{work.words}</span>
      {ready ? <Mark level="busy" text={T.start.ready} /> : null}
      {ready ? <Act label={T.start.begin} name={T.start.beginOf(work.words)} kind="small" motion why={whyNot("release")} onAct={() => void askRelease(id, work.words)} /> : null}
      <Progress fraction={work.fraction ?? 0} label={work.words} />
      <Act label={T.work.cancel} kind="small" onAct={cancelWork} />
    </div>
  );
}

function AxisSelect(props: { label: string; value: string; none?: boolean; onChange: (id: string) => void }): JSX.Element {
  return (
    <label class="field">
      <span>{props.label}</span>
      <select value={props.value} disabled={jogging.value !== null} onChange={(event) => props.onChange(event.currentTarget.value)}>
        {props.none ? <option value={NO_AXIS}>{T.jog.noAxis}</option> : null}
        {allAxes().map((axis) => (
          <option key={axis.id} value={axis.id}>
            {axis.id}
          </option>
        ))}
      </select>
    </label>
  );
}

/** Position, limits and the reason beside the keys, for as long as an axis moves. */
function AxisReadout({ axis }: { axis: AxisStore }): JSX.Element {
  const flags = axis.flags.value;
  const position = useMemo(() => computed(() => formatValue(axis.position.value, axis.flags.value.unit)), [axis]);
  const controller = findController(axis.controller);
  const ready = controller ? readinessOf(axis.id, flags, controller.rest.value, permits.value) : null;
  const age = Math.max(controller?.age.value ?? 0, pageAge.value);
  return (
    <div class={`readout ${age >= 1 ? "stale" : ""}`}>
      <div class="rowhead">
        <b>{axis.id}</b> <span class="quiet">{holderOf(axis).name}</span>
        {age >= 1 ? <span class="age">{T.age(age)}</span> : null}
      </div>
      <div class="big num">
        <span class="value">{position}</span> <span class="unit">{formatUnit(flags.unit)}</span>
      </div>
      <LimitBar axis={axis} />
      {ready ? <Mark level={ready.level} text={ready.text} /> : null}
      {ready?.remedy ? <small class="remedy">{ready.remedy}</small> : null}
    </div>
  );
}

function LimitBar({ axis }: { axis: AxisStore }): JSX.Element | null {
  const place = useMemo(
    () =>
      computed(() => {
        const { min, max } = axis.flags.value;
        const at = axis.position.value;
        if (min === undefined || max === undefined || at === null || max <= min) return "0%";
        return `${(Math.min(1, Math.max(0, (at - min) / (max - min))) * 100).toFixed(1)}%`;
      }),
    [axis],
  );
  const { min, max, unit } = axis.flags.value;
  if (min === undefined || max === undefined) return null;
  return (
    <div class="limits num" title={T.jog.limits}>
      <span>{formatValue(min, unit)}</span>
      <div class="track">
        <Needle place={place} />
      </div>
      <span>{formatValue(max, unit)}</span>
    </div>
  );
}

function Needle({ place }: { place: { value: string } }): JSX.Element {
  return <div class="needle" style={{ left: place.value }} />;
}
