/** What a job will do: each axis over time, the path in the plane, its steps, its budget. */

import type { JSX } from "preact";
import { useMemo, useState } from "preact/hooks";
import { explain, formatNs, formatSeconds, formatUnit } from "../core/format.ts";
import type { Curve, JobForecast, Preview } from "../core/model.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { PathFacts } from "./pathbound.tsx";
import { alignCurves, Plot } from "./plot.tsx";

export function PreviewPlots({ preview, drawn = false }: { preview: Preview; drawn?: boolean }): JSX.Element {
  const axes = Object.entries(preview.axes).filter(([, curve]) => curve.t.length > 0);
  const data = useMemo(() => alignCurves(axes.map(([, curve]) => curve)), [preview]);
  return (
    <div class="preview">
      <p class="facts num">
        <span>{T.preview.duration(formatSeconds(preview.duration_s))}</span>
        {preview.unknown ? <span class="reason">{preview.unknown}</span> : null}
      </p>
      {axes.length > 0 ? (
        <div class="previewplots">
          <Plot series={axes.map(([axis, curve]) => ({ label: axis, unit: curve.unit }))} data={data} height={240} name={T.preview.overTime} />
          {axes.length >= 2 && !drawn ? <PathView preview={preview} /> : null}
        </div>
      ) : null}
    </div>
  );
}

/** The path of two axes in their plane; of three, in parallel projection. */
function PathView({ preview }: { preview: Preview }): JSX.Element {
  const names = Object.keys(preview.axes).filter((axis) => (preview.axes[axis]?.t.length ?? 0) > 0);
  const [chosen, setChosen] = useState<string[]>(names.slice(0, names.length === 3 ? 3 : 2));
  const shown = chosen.filter((axis) => names.includes(axis));
  const points = useMemo(() => projectPath(preview, shown), [preview, shown.join()]);
  const pick = (index: number, axis: string): void => {
    const next = [...shown];
    if (axis === "") next.splice(index, 1);
    else next[index] = axis;
    setChosen([...new Set(next)]);
  };
  return (
    <figure class="path">
      <figcaption>
        {[0, 1, 2].map((index) => (
          <select key={index} aria-label={T.preview.pathAxis(index + 1)} value={shown[index] ?? ""} onChange={(event) => pick(index, event.currentTarget.value)}>
            {index === 2 ? <option value="">–</option> : null}
            {names.map((axis) => (
              <option key={axis} value={axis}>{`${axis} (${formatUnit(preview.axes[axis]?.unit ?? "")})`}</option>
            ))}
          </select>
        ))}
      </figcaption>
      <svg viewBox="0 0 200 200" role="img" aria-label={T.preview.path(shown.join(", "))}>
        <rect class="frame" x="0.5" y="0.5" width="199" height="199" />
        <polyline points={points.map(([x, y]) => `${x.toFixed(1)},${y.toFixed(1)}`).join(" ")} />
        {points[0] ? <circle class="begin" cx={points[0][0]} cy={points[0][1]} r="3.5" /> : null}
        {points.at(-1) ? <rect class="end" x={(points.at(-1)?.[0] ?? 0) - 3} y={(points.at(-1)?.[1] ?? 0) - 3} width="6" height="6" /> : null}
      </svg>
      <small>{T.preview.pathNote}</small>
    </figure>
  );
}

function valueAt(curve: { t: number[]; v: number[] }, time: number): number {
  const after = curve.t.findIndex((each) => each >= time);
  if (after <= 0) return curve.v[after < 0 ? curve.v.length - 1 : 0] ?? 0;
  const [t0 = 0, t1 = 0] = [curve.t[after - 1], curve.t[after]];
  const [v0 = 0, v1 = 0] = [curve.v[after - 1], curve.v[after]];
  return t1 > t0 ? v0 + ((v1 - v0) * (time - t0)) / (t1 - t0) : v1;
}

const PATH_POINTS = 600;

function projectPath(preview: Preview, axes: string[]): [number, number][] {
  const curves = axes.map((axis) => preview.axes[axis]).filter((curve) => curve !== undefined);
  if (curves.length < 2) return [];
  const flat = sampleCurves(curves, PATH_POINTS).map(([x = 0, y = 0, z = 0]): [number, number] => (curves.length > 2 ? [x + 0.5 * y, z + 0.35 * y] : [x, y]));
  return fit(flat);
}

/** The values of all curves at the same instants, from the first begin to the last end. */
export function sampleCurves(curves: Curve[], count: number): number[][] {
  const begin = Math.min(...curves.map((curve) => curve.t[0] ?? 0));
  const end = Math.max(...curves.map((curve) => curve.t.at(-1) ?? 0));
  return Array.from({ length: count + 1 }, (_, i) => curves.map((curve) => valueAt(curve, begin + ((end - begin) * i) / count)));
}

/** Into the square of 200, upwards positive; with the same scale for both, unless one is much smaller. */
function fit(points: [number, number][]): [number, number][] {
  const lowX = Math.min(...points.map(([x]) => x));
  const lowY = Math.min(...points.map(([, y]) => y));
  const wide = Math.max(...points.map(([x]) => x)) - lowX || 1e-9;
  const high = Math.max(...points.map(([, y]) => y)) - lowY || 1e-9;
  const same = Math.max(wide, high) < 50 * Math.min(wide, high);
  const [scaleX, scaleY] = same ? [176 / Math.max(wide, high), 176 / Math.max(wide, high)] : [176 / wide, 176 / high];
  return points.map(([x, y]) => [100 + (x - lowX - wide / 2) * scaleX, 100 - (y - lowY - high / 2) * scaleY]);
}

export function ForecastSteps({ forecast, dryRun }: { forecast?: JobForecast | null | undefined; dryRun?: JobForecast | null | undefined }): JSX.Element | null {
  const steps = (dryRun ?? forecast)?.steps ?? [];
  const conditions = [...(forecast?.conditions ?? [])];
  const problems = [...(forecast?.problems ?? []), ...(dryRun === forecast ? [] : (dryRun?.problems ?? []))];
  if (steps.length === 0 && problems.length === 0) return null;
  return (
    <div>
      {problems.map((problem) => (
        <p class="reason bad" key={problem.text}>
          <span aria-hidden="true">▲</span> {explain(problem)}
        </p>
      ))}
      {conditions.map((text) => (
        <p class="reason" key={text}>
          {onPage(text)}
        </p>
      ))}
      <table class="steps">
        <thead>
          <tr>
            <th scope="col">{T.preview.step}</th>
            <th scope="col">{T.preview.what}</th>
            <th scope="col">{T.preview.lasts}</th>
            <th scope="col">{T.preview.budget}</th>
          </tr>
        </thead>
        <tbody>
          {steps.map((step) => (
            <tr key={step.index}>
              <td class="num">{step.index + 1}</td>
              <td>
                {step.text}
                {step.path ? <PathFacts path={step.path} /> : null}
                {(step.conditions ?? []).map((text) => (
                  <small class="remedy" key={text}>
                    {onPage(text)}
                  </small>
                ))}
              </td>
              <td class="num">{lasts(step.least_s ?? 0, step.most_s)}</td>
              <td class="num">
                {step.budget?.predicted_ns !== undefined ? T.preview.within(formatNs(step.budget.predicted_ns), formatNs(step.budget.allowed_ns)) : "–"}
              </td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

function lasts(least: number, most: number | null | undefined): string {
  if (most === null || most === undefined) return `≥ ${formatSeconds(least)}`;
  return Math.abs(most - least) < 0.05 ? formatSeconds(most) : `${formatSeconds(least)} … ${formatSeconds(most)}`;
}
