/** Clocks: how well each is known, its rate, what was learned, and how that changed over time. */

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { formatNs } from "../core/format.ts";
import { controllers } from "../core/store.ts";
import * as T from "../texts.ts";
import { Empty, Panel } from "./parts.tsx";
import { Plot } from "./plot.tsx";
import { usePolled } from "./polled.ts";

interface ClockShown {
  start_classes?: string[];
  mapping?: { rate_ppm: number; residual_ns: number; bound_ns: number; min_rtt_ns: number; samples: number; consistent?: boolean } | null;
  crystal?: { rate_ppm: number; bound_ppm: number; moves: number } | null;
  unusual_starts?: { outside_ns: number; age_ns: number }[];
  widened_ns?: number;
  rate_ppm?: number | null;
}

interface ClockHistory {
  t: number[];
  bound_us?: (number | null)[];
  offset_us?: (number | null)[];
  rate_ppm?: (number | null)[];
}

interface Clocks {
  clocks: Record<string, ClockShown | null>;
  history?: Record<string, ClockHistory>;
}

const REFRESH_MS = 5000;

export function ClocksPanel(): JSX.Element {
  const shown = usePolled<Clocks>("clocks", REFRESH_MS);
  const [chosen, setChosen] = useState("");
  const name = chosen || (controllers.value.find((controller) => controller.clock.value)?.id ?? controllers.value[0]?.id ?? "");
  return (
    <Panel title={T.clocks.title} area="clocks">
      <table class="num">
        <thead>
          <tr>
            <th scope="col">{T.controller}</th>
            <th scope="col">{T.clocks.bound}</th>
            <th scope="col">{T.clocks.age}</th>
            <th scope="col">{T.clocks.rate}</th>
            <th scope="col">{T.clocks.residual}</th>
            <th scope="col">{T.clocks.classes}</th>
            <th scope="col">{T.clocks.learned}</th>
          </tr>
        </thead>
        <tbody>
          {controllers.value.map((controller) => {
            const clock = controller.clock.value;
            const more = shown?.clocks[controller.id];
            const rate = more?.rate_ppm ?? more?.mapping?.rate_ppm ?? more?.crystal?.rate_ppm;
            return (
              <tr key={controller.id}>
                <th scope="row">
                  <button type="button" class="link" aria-pressed={name === controller.id} onClick={() => setChosen(controller.id)}>
                    {controller.id}
                  </button>
                </th>
                <td>{clock ? `± ${formatNs(clock.bound_ns)}` : T.clocks.none}</td>
                <td>{clock ? formatNs(clock.age_ns) : "–"}</td>
                <td>{rate === undefined || rate === null ? "–" : `${rate.toFixed(3)} ppm`}</td>
                <td>{formatNs(more?.mapping?.residual_ns)}</td>
                <td>{more?.start_classes?.join(", ") ?? "–"}</td>
                <td>{learnedBy(more)}</td>
              </tr>
            );
          })}
        </tbody>
      </table>
      <ClockPlot name={name} history={shown?.history?.[name]} />
    </Panel>
  );
}

function learnedBy(clock: ClockShown | null | undefined): string {
  if (!clock) return "–";
  const parts: string[] = [];
  if (clock.crystal) parts.push(T.clocks.crystal(clock.crystal.moves, clock.crystal.bound_ppm.toFixed(1)));
  const starts = clock.unusual_starts?.length ?? 0;
  if (starts > 0) parts.push(T.clocks.unusual(starts, formatNs(clock.widened_ns ?? 0)));
  if (clock.mapping?.consistent === false) parts.push(T.clocks.inconsistent);
  return parts.join("; ") || "–";
}

type Plotted = "bound" | "offset";

const CURVES: Record<Plotted, { field: "bound_us" | "offset_us" | "rate_ppm"; unit: string }[]> = {
  bound: [
    { field: "bound_us", unit: "µs" },
    { field: "rate_ppm", unit: "ppm" },
  ],
  offset: [
    { field: "offset_us", unit: "µs" },
    { field: "rate_ppm", unit: "ppm" },
  ],
};

function ClockPlot({ name, history }: { name: string; history: ClockHistory | undefined }): JSX.Element {
  const [plotted, setPlotted] = useState<Plotted>("bound");
  if (!history || history.t.length < 2) return <Empty text={T.clocks.noHistory} />;
  const newest = history.t.at(-1) ?? 0;
  const times = history.t.map((time) => time - newest);
  const series = CURVES[plotted].filter(({ field }) => history[field]);
  return (
    <div>
      <select aria-label={T.clocks.plotted} value={plotted} onChange={(event) => setPlotted(event.currentTarget.value === "offset" ? "offset" : "bound")}>
        <option value="bound">{T.clocks.plots.bound}</option>
        <option value="offset">{T.clocks.plots.offset}</option>
      </select>
      <Plot
        key={`${name} ${plotted}`}
        series={series.map(({ field, unit }) => ({ label: `${name} ${T.clocks.curve[field]}`, unit }))}
        data={[times, ...series.map(({ field }) => history[field] ?? [])]}
        height={170}
        name={T.clocks.plot(name)}
      />
    </div>
  );
}
