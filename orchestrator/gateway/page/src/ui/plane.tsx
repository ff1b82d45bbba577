/**
 * Two axes in their plane, live: where they have been, where they are, where they go, and their soft limits.
 *
 * What has been is in the rings of the axes (90 s). It draws five times a second, and only while it can be seen.
 */

import type { JSX } from "preact";
import { effect, signal } from "@preact/signals";
import { useEffect, useRef, useState } from "preact/hooks";
import { formatQuantity, formatUnit, placesOf } from "../core/format.ts";
import { get } from "../core/http.ts";
import { plane } from "../core/look.ts";
import type { Preview } from "../core/model.ts";
import { isFlag, remembered } from "../core/remember.ts";
import { allAxes, findAxis, paths, samples, type AxisStore } from "../core/store.ts";
import * as T from "../texts.ts";
import { Act, Panel } from "./parts.tsx";
import { sampleCurves } from "./preview.tsx";
import { ZoneShadows } from "./zones.tsx";

type Spot = [number, number];

const DRAW_MS = 200;
const PATH_POINTS = 600;
const EDGE_PX = 26; // beside the drawing, for its numbers
const ROOM = 0.06; // of the extent, around it

/** Whether the whole range of the axes is shown, or what they did and will do. */
const whole = remembered("plane.whole", true, isFlag);
/** The path of the running step: as it was planned. */
const course = signal<{ key: string; preview: Preview } | null>(null);

/** The button that shows or hides the view, in the table of axes. */
export function PlaneSwitch(): JSX.Element | null {
  const all = allAxes();
  if (all.length < 2) return null;
  const { shown, axes } = plane.value;
  const known = axes.filter((id) => findAxis(id));
  const next = known.length === 2 ? known : all.slice(0, 2).map((axis) => axis.id);
  return <Act label={T.plane.open} kind="small" name={T.plane.show} pressed={shown} onAct={() => (plane.value = { shown: !shown, axes: next })} />;
}

/** Nothing, until it is switched on. */
export function PlanePanel(): JSX.Element | null {
  const { shown, axes } = plane.value;
  const [x, y] = axes.map(findAxis);
  if (!shown || !x || !y) return null;
  const choose = (index: number, id: string): void => {
    const other = axes[1 - index];
    const next = id === other ? [axes[1], axes[0]] : index === 0 ? [id, other] : [other, id];
    plane.value = { shown, axes: next.filter((axis): axis is string => axis !== undefined) };
  };
  return (
    <Panel
      title={T.plane.title}
      area="plane"
      tools={
        <div class="chips">
          {[x, y].map((axis, index) => (
            <select key={index} aria-label={index === 0 ? T.plane.across : T.plane.upwards} value={axis.id} onChange={(event) => choose(index, event.currentTarget.value)}>
              {allAxes().map((each) => (
                <option key={each.id}>{each.id}</option>
              ))}
            </select>
          ))}
          <Act label={T.plane.whole} kind="small" pressed={whole.value} onAct={() => (whole.value = !whole.value)} />
          <Act label="×" kind="small" name={T.plane.hide} onAct={() => (plane.value = { shown: false, axes })} />
        </div>
      }
    >
      <PlaneDrawing key={`${x.id} ${y.id}`} x={x} y={y} />
    </Panel>
  );
}

interface Drawing {
  trail: Spot[];
  here: Spot | null;
  target: Spot | null;
  ahead: Spot[];
}

function PlaneDrawing({ x, y }: { x: AxisStore; y: AxisStore }): JSX.Element {
  const box = useRef<HTMLDivElement>(null);
  const [size, setSize] = useState({ width: 300, height: 240 });
  const [drawing, setDrawing] = useState<Drawing>(() => collect(x, y));
  useEffect(() => {
    const place = box.current;
    if (place === null) return;
    const watch = new ResizeObserver(() => setSize({ width: Math.max(120, place.clientWidth), height: Math.max(100, place.clientHeight) }));
    watch.observe(place);
    return () => watch.disconnect();
  }, []);
  useEffect(() => {
    let drawnMs = -Infinity;
    return effect(() => {
      samples.value;
      course.value;
      const now = performance.now();
      if (now - drawnMs < DRAW_MS || document.visibilityState !== "visible") return;
      drawnMs = now;
      setDrawing(collect(x, y));
    });
  }, []);
  useEffect(() => effect(() => followPath(x.id, y.id)), []);
  const limits = limitsOf(x, y);
  const view = chooseView(drawing, limits, x, y);
  const place = placer(view, size, x.flags.value.unit === y.flags.value.unit);
  const { trail, here, target, ahead } = drawing;
  const line = (spots: Spot[]): string => spots.map((spot) => place(spot).map((pixel) => pixel.toFixed(1)).join()).join(" ");
  const [hereX, hereY] = here ? place(here) : [0, 0];
  const frame = limits ? [place([limits.low[0], limits.high[1]]), place([limits.high[0], limits.low[1]])] : null;
  return (
    <div class="planebox" ref={box}>
      <svg width={size.width} height={size.height} role="img" aria-label={T.plane.name(x.id, y.id, here ? formatQuantity(here[0], x.flags.value.unit) : "–", here ? formatQuantity(here[1], y.flags.value.unit) : "–")}>
        {frame && frame[0] && frame[1] ? (
          <rect class="limits" x={frame[0][0]} y={frame[0][1]} width={frame[1][0] - frame[0][0]} height={frame[1][1] - frame[0][1]} />
        ) : null}
        <ZoneShadows x={x} y={y} place={place} />
        {ahead.length > 1 ? <polyline class="ahead" points={line(ahead)} /> : null}
        {target && here ? <polyline class="ahead" points={line([here, target])} /> : null}
        {target ? <rect class="target" x={place(target)[0] - 4} y={place(target)[1] - 4} width="8" height="8" /> : null}
        <polyline class="trail" points={line(trail)} />
        {here ? (
          <g class="here">
            <line x1={hereX - 9} y1={hereY} x2={hereX + 9} y2={hereY} />
            <line x1={hereX} y1={hereY - 9} x2={hereX} y2={hereY + 9} />
            <circle cx={hereX} cy={hereY} r="4.5" />
          </g>
        ) : null}
        <Numbers ends={whole.value && limits ? limits : view} size={size} place={place} x={x} y={y} />
      </svg>
    </div>
  );
}

/** The ends of what is shown, at the edges. */
function Numbers(props: { ends: Extent; size: { width: number; height: number }; place: (spot: Spot) => Spot; x: AxisStore; y: AxisStore }): JSX.Element {
  const { ends, size, place, x, y } = props;
  const [left, bottom] = place(ends.low);
  const [right, top] = place(ends.high);
  const name = (axis: AxisStore): string => `${axis.id} (${formatUnit(axis.flags.value.unit)})`;
  const base = size.height - 6;
  return (
    <g class="numbers" aria-hidden="true">
      <text x={left} y={base}>
        {short(ends.low[0])}
      </text>
      {right - left > NAME_PX ? <text x={(left + right) / 2} y={base} text-anchor="middle">{name(x)}</text> : null}
      <text x={right} y={base} text-anchor="end">
        {short(ends.high[0])}
      </text>
      <text transform={`translate(14 ${bottom}) rotate(-90)`}>{short(ends.low[1])}</text>
      {bottom - top > NAME_PX ? <text transform={`translate(14 ${(bottom + top) / 2}) rotate(-90)`} text-anchor="middle">{name(y)}</text> : null}
      <text transform={`translate(14 ${top}) rotate(-90)`} text-anchor="end">
        {short(ends.high[1])}
      </text>
    </g>
  );
}

const NAME_PX = 190; // with less, the name of an axis would overlap them

function short(value: number): string {
  return String(Number(value.toPrecision(4)));
}

/** Both rings are filled at the same instants, while both positions are known. */
function collect(x: AxisStore, y: AxisStore): Drawing {
  const across = new Map(x.ring.since(-Infinity));
  const trail: Spot[] = [];
  for (const [time, value] of y.ring.since(-Infinity)) {
    const other = across.get(time);
    const last = trail.at(-1);
    if (other !== undefined && !(last && last[0] === other && last[1] === value)) trail.push([other, value]);
  }
  const [nowX, nowY] = [x.position.peek(), y.position.peek()];
  const here: Spot | null = nowX !== null && nowY !== null ? [nowX, nowY] : null;
  if (here) trail.push(here);
  const [toX, toY] = [x.target.peek(), y.target.peek()];
  const goes = (x.flags.peek().moving && toX !== null) || (y.flags.peek().moving && toY !== null);
  return { trail, here, target: here && goes ? [toX ?? here[0], toY ?? here[1]] : null, ahead: aheadOf(x.id, y.id) };
}

function aheadOf(x: string, y: string): Spot[] {
  const curves = [x, y].map((id) => course.peek()?.preview.axes[id]);
  const [first, second] = curves;
  return first && second ? sampleCurves([first, second], PATH_POINTS).map(([a = 0, b = 0]): Spot => [a, b]) : [];
}

/** Load the path of the running step, once, if both axes are on it. */
function followPath(x: string, y: string): void {
  const running = Object.entries(paths.value).find(([, path]) => path.axes.includes(x) && path.axes.includes(y));
  const key = running ? `${running[0]} ${running[1].step}` : "";
  if (course.peek()?.key === key) return;
  course.value = null;
  if (!running) return;
  void get<Preview>(`jobs/${encodeURIComponent(running[0])}/path/${running[1].step}`).then((answer) => {
    const path = paths.peek()[running[0]];
    if ("ok" in answer && path?.step === running[1].step) course.value = { key, preview: answer.ok };
  });
}

interface Extent {
  low: Spot;
  high: Spot;
}

function limitsOf(x: AxisStore, y: AxisStore): Extent | null {
  const [a, b] = [x.flags.value, y.flags.value];
  if (a.min === undefined || a.max === undefined || b.min === undefined || b.max === undefined) return null;
  return { low: [a.min, b.min], high: [a.max, b.max] };
}

/** What is shown: the soft limits, or what the axes did and will do; axes beyond their limits stay in sight. */
function chooseView(drawing: Drawing, limits: Extent | null, x: AxisStore, y: AxisStore): Extent {
  const spots = whole.value && limits ? [limits.low, limits.high] : [...drawing.trail, ...drawing.ahead];
  if (drawing.here) spots.push(drawing.here);
  if (drawing.target) spots.push(drawing.target);
  const side = (index: 0 | 1, unit: string): [number, number] => {
    const values = spots.map((spot) => spot[index]);
    const [low, high] = values.length > 0 ? [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))] : [0, 0];
    // A resting axis does not fill the view with its noise.
    const room = Math.max((high - low) * ROOM, (100 * 10 ** -placesOf(unit) - (high - low)) / 2, 0);
    return [low - room, high + room];
  };
  const [lowX, highX] = side(0, x.flags.value.unit);
  const [lowY, highY] = side(1, y.flags.value.unit);
  return { low: [lowX, lowY], high: [highX, highY] };
}

/** From positions to pixels; axes of one unit have one scale. */
function placer(view: Extent, size: { width: number; height: number }, same: boolean): (spot: Spot) => Spot {
  const [wide, high] = [size.width - EDGE_PX - 8, size.height - EDGE_PX - 8];
  let [scaleX, scaleY] = [wide / (view.high[0] - view.low[0]), high / (view.high[1] - view.low[1])];
  if (same) scaleX = scaleY = Math.min(scaleX, scaleY);
  const [middleX, middleY] = [(view.low[0] + view.high[0]) / 2, (view.low[1] + view.high[1]) / 2];
  return ([x, y]) => [EDGE_PX + wide / 2 + (x - middleX) * scaleX, 8 + high / 2 - (y - middleY) * scaleY];
}
