/** The points of a scan: how far each axis was off, as a plot over all points, and as a table by pages. */

import type { JSX } from "preact";
import { useEffect, useMemo, useState } from "preact/hooks";
import { explain, formatNs, formatQuantity } from "../core/format.ts";
import { get } from "../core/http.ts";
import type { ScanPoint, ScanSummary } from "../core/model.ts";
import { findAxis } from "../core/store.ts";
import * as T from "../texts.ts";
import { Act, Empty } from "./parts.tsx";
import { Plot, type PlotData } from "./plot.tsx";
import { PointMark } from "./verdict.tsx";

const PAGE = 25;
const MOST_PLOTTED = 5000; // what the gateway gives at once

interface Props {
  job: string;
  step: number;
  scan: ScanSummary;
  /** The job was done: what is green may be called so. */
  green: boolean;
}

export function ScanPoints(props: Props): JSX.Element {
  const [open, setOpen] = useState(false);
  if (!open) return <Act label={T.points.show} name={T.points.showOf(props.step + 1)} kind="small" onAct={() => setOpen(true)} />;
  return <OpenPoints {...props} />;
}

function OpenPoints({ job, step, scan, green }: Props): JSX.Element {
  const [points, setPoints] = useState<ScanPoint[] | null>(null);
  const [page, setPage] = useState(0);
  const [late, setLate] = useState<ScanPoint[] | null>(null);
  const [why, setWhy] = useState("");
  const load = async (after: number, limit: number): Promise<ScanPoint[] | null> => {
    const answer = await get<{ points?: ScanPoint[] }>(`jobs/${encodeURIComponent(job)}/points?step=${step}&after=${after}&limit=${limit}`);
    if ("refused" in answer) setWhy(explain(answer.refused));
    return "ok" in answer ? (answer.ok.points ?? []).filter((point) => point.step === step) : null;
  };
  useEffect(() => {
    void load(0, MOST_PLOTTED).then(setPoints);
  }, [job, step]);
  const first = page * PAGE;
  const far = points !== null && points.length >= MOST_PLOTTED && first + PAGE > MOST_PLOTTED;
  useEffect(() => {
    setLate(null);
    if (far) void load(points[first - 1]?.point ?? first, PAGE).then(setLate);
  }, [far, page]);
  if (why) return <Empty text={why} />;
  if (points === null) return <Empty text={T.loading} />;
  if (points.length === 0) return <Empty text={T.points.none} />;
  const rows = far ? (late ?? []) : points.slice(first, first + PAGE);
  const all = Math.max(points.length, points.length >= MOST_PLOTTED ? scan.points : 0);
  return (
    <div class="scanpoints">
      <DeviationPlot points={points} />
      {all > points.length ? <p class="hint">{T.points.plotted(points.length)}</p> : null}
      <PointTable rows={rows} green={green} />
      <div class="row">
        <Act label={T.points.earlier} kind="small" why={page === 0 ? T.points.isFirst : ""} onAct={() => setPage(page - 1)} />
        <span class="num">{T.points.range(rows[0]?.point ?? first + 1, rows.at(-1)?.point ?? first + PAGE, all)}</span>
        <Act label={T.points.later} kind="small" why={first + PAGE >= all ? T.points.isLast : ""} onAct={() => setPage(page + 1)} />
      </div>
    </div>
  );
}

function PointTable({ rows, green }: { rows: ScanPoint[]; green: boolean }): JSX.Element {
  return (
    <table class="num points">
      <thead>
        <tr>
          <th scope="col">{T.points.point}</th>
          <th scope="col">{T.points.target}</th>
          <th scope="col">{T.points.off}</th>
          <th scope="col">{T.points.verdict}</th>
          <th scope="col">{T.points.skew}</th>
        </tr>
      </thead>
      <tbody>
        {rows.map((row) => (
          <tr key={row.point}>
            <th scope="row">{row.point}</th>
            <td>{ofAxes(row, (axis) => row.target[axis] ?? null)}</td>
            <td>{ofAxes(row, (axis) => offOf(row, axis))}</td>
            <td>
              <PointMark state={row.state} verdict={row.verdict} green={green} />
            </td>
            <td>{row.start_skew ? `≤ ${formatNs(row.start_skew.at_most_ns)}` : "–"}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

function ofAxes(row: ScanPoint, value: (axis: string) => number | null): JSX.Element[] {
  return Object.keys(row.target).map((axis) => {
    const now = value(axis);
    return <span key={axis} class="ofaxis">{`${axis} ${now === null ? "–" : formatQuantity(now, unitOf(axis))}`}</span>;
  });
}

function offOf(row: ScanPoint, axis: string): number | null {
  const [measured, target] = [row.measured[axis], row.target[axis]];
  return measured === null || measured === undefined || target === undefined ? null : measured - target;
}

function unitOf(axis: string): string {
  return findAxis(axis)?.flags.value.unit ?? "";
}

function DeviationPlot({ points }: { points: ScanPoint[] }): JSX.Element {
  const axes = Object.keys(points[0]?.target ?? {});
  const data = useMemo((): PlotData => [points.map((row) => row.point), ...axes.map((axis) => points.map((row) => offOf(row, axis)))], [points]);
  return (
    <Plot
      series={axes.map((axis) => ({ label: T.points.offAxis(axis), unit: unitOf(axis), points: true }))}
      data={data}
      height={200}
      name={T.points.plot(axes.join(", "))}
      across=""
    />
  );
}
