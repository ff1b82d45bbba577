/** uPlot as a component: curves over time, in as many scales as there are units. */

import type { JSX } from "preact";
import { useEffect, useRef } from "preact/hooks";
import uPlot from "uplot";
import { formatUnit, placesOf } from "../core/format.ts";
import { theme } from "../core/look.ts";

export interface PlotSeries {
  label: string;
  unit: string;
  points?: boolean;
  /** Which of the colours; without it that of its place. */
  colour?: number;
}

/** An instant that is marked, with a short text at its top. */
export interface PlotMark {
  at: number;
  label: string;
}

export type PlotData = (number | null)[][];

/** Told apart by dashes as well as by colour. */
const DASHES = [[], [8, 4], [2, 3], [10, 3, 2, 3], [5, 2], [1, 4]];

function colourOf(element: Element, name: string): string {
  return getComputedStyle(element).getPropertyValue(name).trim() || "gray";
}

/** Between ticks of what is counted. */
const WHOLE = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];

interface PlotProps {
  series: PlotSeries[];
  /** The times in seconds, then the values of each series. */
  data: PlotData;
  height: number;
  name: string;
  range?: [number, number];
  marks?: PlotMark[];
  /** The unit of what is plotted over; seconds without it. */
  across?: string;
  /** A plot whose data change often takes them by itself: it is called with the function that draws. */
  feed?: (draw: (data: PlotData) => void) => () => void;
}

export function Plot({ series, data, height, name, range, marks, across = "s", feed }: PlotProps): JSX.Element {
  const box = useRef<HTMLDivElement>(null);
  const chart = useRef<uPlot | null>(null);
  const shape = JSON.stringify([series, range, marks, theme.value]);
  useEffect(() => {
    const place = box.current;
    if (place === null) return;
    let legend = 24;
    const size = (): { width: number; height: number } => ({
      width: Math.max(120, place.clientWidth),
      height: Math.max(80, height || place.clientHeight - legend),
    });
    const made = new uPlot({ ...size(), ...optionsOf(place, series, across, range), hooks: marks ? { draw: [(chart) => drawMarks(chart, place, marks)] } : {} }, data as uPlot.AlignedData, place);
    chart.current = made;
    const watch = new ResizeObserver(() => {
      legend = made.root.querySelector<HTMLElement>(".u-legend")?.offsetHeight ?? legend;
      const now = size();
      if (now.width !== made.width || now.height !== made.height) made.setSize(now);
    });
    watch.observe(place);
    const stop = feed?.((fresh) => made.setData(fresh as uPlot.AlignedData));
    return () => {
      stop?.();
      watch.disconnect();
      made.destroy();
      chart.current = null;
    };
  }, [shape, height]);
  useEffect(() => {
    if (!feed) chart.current?.setData(data as uPlot.AlignedData);
  }, [data]);
  return <div class={`plot ${height ? "" : "fills"}`} role="img" aria-label={name} data-range={range?.join(" ")} ref={box} />;
}

function optionsOf(place: Element, series: PlotSeries[], across: string, range?: [number, number]): Omit<uPlot.Options, "width" | "height"> {
  const ink = colourOf(place, "--ink-2");
  const root = parseFloat(getComputedStyle(document.documentElement).fontSize) / 16;
  const font = `${Math.round(12 * root)}px system-ui, sans-serif`;
  const grid = { stroke: colourOf(place, "--line"), width: 1 };
  const units = [...new Set(series.map((each) => each.unit))];
  const scales: uPlot.Scales = { x: range ? { time: false, range: () => range } : { time: false } };
  for (const unit of units) scales[unit] = { range: (_, low, high) => widen(low, high, unit) };
  return {
    cursor: { drag: { x: false, y: false } },
    legend: { live: false },
    scales,
    axes: [
      { stroke: ink, grid, ticks: grid, ...(across === "" ? { incrs: WHOLE } : {}), space: 60 * root, size: 30 * root, font, values: (_, ticks) => ticks.map((tick) => `${+tick.toFixed(3)} ${across}`.trim()) },
      ...units.slice(0, 2).map(
        (unit, index): uPlot.Axis => ({
          scale: unit,
          space: 36 * root,
          side: index === 0 ? 3 : 1,
          stroke: ink,
          grid: { ...grid, show: index === 0 },
          ticks: grid,
          size: 62 * root,
          font,
          values: (_, ticks) => ticks.map((tick) => `${+tick.toFixed(placesOf(unit))}`),
          label: formatUnit(unit),
          labelSize: 18 * root,
          labelFont: font,
        }),
      ),
    ],
    series: [
      {},
      ...series.map((each, index): uPlot.Series => {
        const number = (each.colour ?? index) % 6;
        const colour = colourOf(place, `--curve-${number + 1}`);
        const dash = DASHES[number] ?? [];
        return {
          label: `${each.label} (${formatUnit(each.unit)})`,
          scale: each.unit,
          stroke: colour,
          width: each.points ? 0 : 1.75,
          dash,
          points: each.points ? { show: true, size: 4, fill: colour } : { show: false },
          spanGaps: true,
        };
      }),
    ],
  };
}

const MARK_PX = 26; // between two texts of marks

/** A line at each instant, with its text where there is room. */
function drawMarks(chart: uPlot, place: Element, marks: PlotMark[]): void {
  const { ctx, bbox } = chart;
  const pixels = window.devicePixelRatio || 1;
  ctx.save();
  ctx.strokeStyle = colourOf(place, "--ink-2");
  ctx.fillStyle = colourOf(place, "--ink-2");
  ctx.globalAlpha = marks.length > 40 ? 0.25 : 0.6;
  ctx.lineWidth = pixels;
  ctx.setLineDash([2 * pixels, 3 * pixels]);
  ctx.font = `${11 * pixels}px system-ui, sans-serif`;
  ctx.textBaseline = "top";
  let free = -Infinity;
  for (const mark of marks) {
    const x = Math.round(chart.valToPos(mark.at, "x", true));
    ctx.beginPath();
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    if (x < free || x + MARK_PX * pixels > bbox.left + bbox.width + MARK_PX * pixels) continue;
    ctx.globalAlpha = 1;
    ctx.fillText(mark.label, x + 3 * pixels, bbox.top + 2 * pixels);
    ctx.globalAlpha = marks.length > 40 ? 0.25 : 0.6;
    free = x + MARK_PX * pixels;
  }
  ctx.restore();
}

/** A range that a resting axis does not fill with its noise. */
function widen(low: number | null, high: number | null, unit: string): [number, number] {
  if (low === null || high === null) return [0, 1];
  const least = 20 * 10 ** -placesOf(unit);
  const room = Math.max((high - low) * 0.08, (least - (high - low)) / 2, 0);
  return [low - room, high + room];
}

/** Curves with times of their own on common times; null where a curve has no point. */
export function alignCurves(curves: { t: number[]; v: number[] }[]): PlotData {
  const times = [...new Set(curves.flatMap((curve) => curve.t))].sort((a, b) => a - b);
  const places = new Map(times.map((time, index) => [time, index]));
  const data: PlotData = [times];
  for (const curve of curves) {
    const values: (number | null)[] = new Array<number | null>(times.length).fill(null);
    curve.t.forEach((time, index) => {
      const at = places.get(time);
      if (at !== undefined) values[at] = curve.v[index] ?? null;
    });
    data.push(values);
  }
  return data;
}
