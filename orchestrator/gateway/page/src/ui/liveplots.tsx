/** Live plots of the chosen axes over the last minute. */

import type { JSX } from "preact";
import { effect } from "@preact/signals";
import { plotted } from "../core/look.ts";
import { allAxes, findAxis, samples, type AxisStore } from "../core/store.ts";
import * as T from "../texts.ts";
import { togglePlot } from "./axes.tsx";
import { Act, Panel } from "./parts.tsx";
import { Plot, type PlotData } from "./plot.tsx";

const WINDOW_S = 60;
const DRAW_MS = 200;

/** Nothing, until an axis is chosen in the table. */
export function LivePlots(): JSX.Element | null {
  const axes = plotted.value.map(findAxis).filter((axis): axis is AxisStore => axis !== undefined);
  if (axes.length === 0) return null;
  const others = allAxes().filter((axis) => !axes.includes(axis));
  return (
    <Panel
      title={T.plots.title}
      area="plots"
      tools={
        <div class="chips">
          {axes.map((axis) => (
            <Act key={axis.id} label={`${axis.id} ×`} name={T.plots.remove(axis.id)} kind="small" onAct={() => togglePlot(axis.id)} />
          ))}
          {others.length > 0 ? (
            <select aria-label={T.plots.add} value="" onChange={(event) => togglePlot(event.currentTarget.value)}>
              <option value="">{T.plots.add}</option>
              {others.map((axis) => (
                <option key={axis.id}>{axis.id}</option>
              ))}
            </select>
          ) : null}
        </div>
      }
    >
      <Plot
        key={axes.map((axis) => axis.id).join()}
        series={axes.map((axis) => ({ label: axis.id, unit: axis.flags.value.unit }))}
        data={collect(axes)}
        height={0}
        range={[-WINDOW_S, 0]}
        name={T.plots.name(axes.map((axis) => axis.id).join(", "))}
        feed={(draw) => feed(axes, draw)}
      />
    </Panel>
  );
}

/** Draw when samples have come, five times a second at most, and only while it can be seen. */
function feed(axes: AxisStore[], draw: (data: PlotData) => void): () => void {
  let drawnMs = -Infinity;
  return effect(() => {
    samples.value;
    const now = performance.now();
    if (now - drawnMs < DRAW_MS || document.visibilityState !== "visible") return;
    drawnMs = now;
    draw(collect(axes));
  });
}

function collect(axes: AxisStore[]): PlotData {
  const now = performance.now() / 1000;
  const times: number[] = [];
  const columns: (number | null)[][] = [];
  // All rings are filled at the same instants: that with the most samples has the times.
  const longest = axes.reduce((best, axis) => (axis.ring.length > best.ring.length ? axis : best));
  for (const [time] of longest.ring.since(now - WINDOW_S)) times.push(time);
  for (const axis of axes) {
    const column: (number | null)[] = [];
    for (const [time, value] of axis.ring.since(now - WINDOW_S)) {
      while (column.length < times.length && (times[column.length] as number) < time) column.push(null);
      if (column.length < times.length) column.push(value);
    }
    while (column.length < times.length) column.push(null);
    columns.push(column);
  }
  return [times.map((time) => time - now), ...columns];
}
