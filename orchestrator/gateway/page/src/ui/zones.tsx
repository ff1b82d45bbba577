/** The keep-out zones in space, and what each rule says. The picture is turned by the pointer or the arrow keys. */

import type { JSX } from "preact";
import { signal } from "@preact/signals";
import { useRef } from "preact/hooks";
import { isFlag, remembered } from "../core/remember.ts";
import type { AxisStore } from "../core/store.ts";
import { dot, isBroken, seenFrom, useZones, zones, type Outline, type Spot, type Vector, type ZoneRule, type ZoneState } from "../core/zones.ts";
import * as T from "../texts.ts";
import { Act, Mark, Panel } from "./parts.tsx";

const shown = remembered("zones", false, isFlag);
/** From where one looks, rad: turned about z, and from how far above. */
const FIRST = { turn: -0.6, tilt: 0.45 };
const eye = signal(FIRST);

const PIXEL = 0.01; // rad, of a drag
const KEY = 0.15; // rad, of an arrow key
const SIZE = 200; // of the drawing, in its own units
const TURNS: Record<string, Spot> = { ArrowLeft: [-KEY, 0], ArrowRight: [KEY, 0], ArrowUp: [0, KEY], ArrowDown: [0, -KEY] };

/** The button that shows or hides the view, of a fleet that has zones. */
export function ZonesSwitch(): JSX.Element | null {
  const rules = zones.value?.rules ?? [];
  if (rules.length === 0) return null;
  const broken = rules.some((rule) => rule.holds === false);
  return <Act label={broken ? `▲ ${T.zones.open}` : T.zones.open} name={broken ? T.zones.broken : T.zones.title} kind="small" pressed={shown.value} onAct={() => (shown.value = !shown.value)} />;
}

/** Nothing, until it is switched on. */
export function ZonesPanel(): JSX.Element | null {
  return shown.value && zones.value?.rules?.length ? <ShownZones /> : null;
}

function ShownZones(): JSX.Element | null {
  const state = useZones();
  if (!state) return null;
  return (
    <Panel
      title={T.zones.title}
      area="zones"
      tools={
        <div class="chips">
          <Act label={T.zones.reset} kind="small" onAct={() => (eye.value = FIRST)} />
          <Act label="×" kind="small" name={T.zones.hide} onAct={() => (shown.value = false)} />
        </div>
      }
    >
      <div class="zonesbox">
        <Space state={state} />
        <ul class="zonerules">
          {[...(state.rules ?? [])].sort((a, b) => rankOf(a) - rankOf(b)).map((rule) => (
            <RuleRow key={rule.rule} rule={rule} />
          ))}
          <li class="quiet">{T.zones.software}</li>
        </ul>
      </div>
    </Panel>
  );
}

/** What is broken comes first, then what is not known, then what is nearest to its end. */
function rankOf(rule: ZoneRule): number {
  if (rule.holds === false) return -2;
  if (rule.holds === null) return -1;
  return typeof rule.distance === "number" ? rule.distance - (rule.least ?? 0) : 1e9;
}

function RuleRow({ rule }: { rule: ZoneRule }): JSX.Element {
  const apart = typeof rule.distance === "number" ? T.zones.apart(rule.distance, rule.least ?? 0) : "";
  return (
    <li title={rule.text}>
      <Mark level={rule.holds === false ? "bad" : rule.holds ? "ok" : "off"} text={rule.rule} />
      <span class="num">{apart || (rule.holds === null ? T.zones.unknown : rule.holds ? "" : rule.text)}</span>
    </li>
  );
}

function Space({ state }: { state: ZoneState }): JSX.Element {
  const from = useRef<Spot | null>(null);
  const { turn, tilt } = eye.value;
  const turnBy = (across: number, upwards: number): void => {
    eye.value = { turn: turn + across, tilt: Math.min(Math.PI / 2, Math.max(0, tilt + upwards)) };
  };
  const right: Vector = [Math.cos(turn), Math.sin(turn), 0];
  const up: Vector = [-Math.sin(turn) * Math.sin(tilt), Math.cos(turn) * Math.sin(tilt), Math.cos(tilt)];
  const back: Vector = [Math.sin(turn) * Math.cos(tilt), -Math.cos(turn) * Math.cos(tilt), Math.sin(tilt)];
  const parts = list(state)
    .map((part) => ({ ...part, hull: seenFrom(part.outline, right, up), depth: part.outline.corners.reduce((sum, corner) => sum + dot(corner, back), 0) / part.outline.corners.length }))
    .sort((a, b) => a.depth - b.depth);
  const spots = parts.flatMap((part) => part.hull);
  const ends = [0, 1].map((side) => spots.map((spot) => spot[side] ?? 0)).map((values) => [Math.min(...values), Math.max(...values)] as const);
  const [[left, rightEnd], [bottom, top]] = ends as [readonly [number, number], readonly [number, number]];
  const scale = (SIZE * 0.94) / Math.max(rightEnd - left, top - bottom, 1e-9);
  const place = ([x, y]: Spot): string => `${(SIZE / 2 + (x - (left + rightEnd) / 2) * scale).toFixed(1)},${(SIZE / 2 - (y - (bottom + top) / 2) * scale).toFixed(1)}`;
  return (
    <div
      class="space"
      tabIndex={0}
      role="img"
      aria-label={T.zones.name(Object.keys(state.bodies ?? {}).join(", "))}
      onKeyDown={(event) => {
        const by = TURNS[event.key];
        if (!by) return;
        event.preventDefault();
        turnBy(...by);
      }}
      onPointerDown={(event) => {
        event.currentTarget.setPointerCapture(event.pointerId);
        from.current = [event.clientX, event.clientY];
      }}
      onPointerMove={(event) => {
        if (!from.current) return;
        turnBy(-(event.clientX - from.current[0]) * PIXEL, (event.clientY - from.current[1]) * PIXEL);
        from.current = [event.clientX, event.clientY];
      }}
      onPointerUp={() => (from.current = null)}
      onLostPointerCapture={() => (from.current = null)}
    >
      <svg viewBox={`0 0 ${SIZE} ${SIZE}`} aria-hidden="true">
        {parts.map((part) => (
          <g key={part.key} class={part.look}>
            <title>{part.outline.description ? `${part.name}: ${part.outline.description}` : part.name}</title>
            <polygon points={part.hull.map(place).join(" ")} />
            {part.outline.radius
              ? null
              : part.outline.edges?.map(([first, second]) => {
                  const corners = [part.outline.corners[first], part.outline.corners[second]].filter((corner): corner is Vector => corner !== undefined);
                  return <polyline key={`${first} ${second}`} points={corners.map((corner) => place([dot(corner, right), dot(corner, up)])).join(" ")} />;
                })}
          </g>
        ))}
      </svg>
    </div>
  );
}

interface Part {
  key: string;
  name: string;
  look: string;
  outline: Outline;
}

function list(state: ZoneState): Part[] {
  const parts = (kind: string, outlines: Record<string, Outline> | undefined): Part[] =>
    Object.entries(outlines ?? {}).map(([name, outline]) => ({
      key: `${kind} ${name}`,
      name,
      look: `${kind}${isBroken(state, name) ? " broken" : ""}${outline.certain === false ? " anywhere" : ""}`,
      outline,
    }));
  return [...parts("region", state.regions), ...parts("zonebody", state.bodies)];
}

/** The bodies in the plane of two axes that move something along two directions at a right angle, in user positions. */
export function ZoneShadows({ x, y, place }: { x: AxisStore; y: AxisStore; place: (spot: Spot) => Spot }): JSX.Element | null {
  const state = useZones();
  const [across, upwards] = [x, y].map((axis) => state?.ways?.[axis.id]);
  if (!state || !across || !upwards) return null;
  const [sizeX, sizeY] = [Math.hypot(...across), Math.hypot(...upwards)];
  if (Math.abs(dot(across, upwards)) > 1e-6 * sizeX * sizeY) return null;
  const unit = (way: Vector, size: number): Vector => way.map((part) => part / size) as Vector;
  const [offsetX, offsetY] = [x, y].map((axis) => Number(axis.flags.value.offset ?? 0)) as Spot;
  const spots = (outline: Outline): string =>
    seenFrom(outline, unit(across, sizeX), unit(upwards, sizeY))
      .map(([a, b]) => place([a / sizeX + offsetX, b / sizeY + offsetY]).map((pixel) => pixel.toFixed(1)).join())
      .join(" ");
  return (
    <g class="shadows">
      {list(state).map((part) => (
        <g key={part.key} class={part.look}>
          <title>{part.name}</title>
          <polygon points={spots(part.outline)} />
        </g>
      ))}
    </g>
  );
}
