/** All steps of a job in one plot, and planned against actual of one step. Time 0 is T0 of the first step shown. */

import type { JSX } from "preact";
import { useEffect, useMemo, useState } from "preact/hooks";
import { explain } from "../core/format.ts";
import { get } from "../core/http.ts";
import type { Curve, JobCurves, Recording } from "../core/model.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { Act, Empty, openDialog } from "./parts.tsx";
import { alignCurves, Plot, type PlotSeries } from "./plot.tsx";

/** Opens the plot of a job: one press from wherever the job is named. */
export function PlotJob({ id, name }: { id: string; name: string }): JSX.Element {
  return <Act label={T.jobPlot.open} name={T.jobPlot.openOf(name)} kind="small" onAct={() => openDialog(T.jobPlot.title(name), <JobPlot id={id} />, true)} />;
}

export function JobPlot({ id }: { id: string }): JSX.Element {
  const [curves, setCurves] = useState<JobCurves | null>(null);
  const [why, setWhy] = useState("");
  useEffect(() => {
    void get<JobCurves>(`jobs/${encodeURIComponent(id)}/plot`).then((answer) => {
      if ("ok" in answer) setCurves(answer.ok);
      else setWhy(explain(answer.refused));
    });
  }, [id]);
  if (why) return <Empty text={why} />;
  if (curves === null) return <Empty text={T.loading} />;
  const { steps } = curves;
  return (
    <div class="jobplot">
      <CurvesPlot
        axes={curves.axes}
        height={360}
        name={T.jobPlot.name(Object.keys(curves.axes).join(", "), (steps[0]?.index ?? 0) + 1, (steps.at(-1)?.index ?? 0) + 1)}
        marks={steps.map((step) => ({ at: step.t0, label: String(step.index + 1) }))}
      />
      <p class="hint">
        {T.jobPlot.hint}
        {curves.left_out > 0 ? ` ${T.jobPlot.leftOut(curves.left_out)}` : ""}
      </p>
      <details>
        <summary>{T.jobPlot.steps(steps.length)}</summary>
        <table class="num">
          <tbody>
            {steps.map((step) => (
              <tr key={step.index}>
                <th scope="row">
                  {onPage(step.text)}
                  {step.name ? `: ${step.name}` : ""}
                </th>
                <td>{T.jobPlot.span(step.t0.toFixed(3), step.t1.toFixed(3))}</td>
              </tr>
            ))}
          </tbody>
        </table>
      </details>
    </div>
  );
}

/** Planned and actual of one step. */
export function RecordingPlot({ recording }: { recording: Recording }): JSX.Element {
  const names = Object.keys(recording.axes);
  const [chosen, setChosen] = useState(names[0] ?? "");
  const axis = recording.axes[chosen];
  if (!axis) return <Empty text={T.history.noRecording} />;
  return (
    <div>
      <select aria-label={T.axes.axis} value={chosen} onChange={(event) => setChosen(event.currentTarget.value)}>
        {names.map((name) => (
          <option key={name}>{name}</option>
        ))}
      </select>
      <CurvesPlot key={chosen} axes={{ [chosen]: axis }} height={240} name={T.history.plot(chosen)} />
    </div>
  );
}

type AxisCurves = Recording["axes"];

/** From T0 on: what was read while the step was armed tells nothing of its motion. */
function CurvesPlot(props: { axes: AxisCurves; height: number; name: string; marks?: { at: number; label: string }[] }): JSX.Element {
  const list = Object.entries(props.axes);
  const data = useMemo(() => alignCurves(list.flatMap(([, axis]) => [fromZero(axis.planned), fromZero(axis.actual)])), [props.axes]);
  const series = list.flatMap(([name, axis], index): PlotSeries[] => [
    { label: T.history.planned(name), unit: axis.unit, colour: index },
    // Of several axes, both curves of one have its colour.
    { label: T.history.actual(name), unit: axis.unit, colour: list.length === 1 ? 1 : index, points: true },
  ]);
  const end = data[0]?.at(-1) ?? 0;
  return <Plot series={series} data={data} height={props.height} name={props.name} range={[0, end || 1]} {...(props.marks ? { marks: props.marks } : {})} />;
}

function fromZero(curve: Curve): Curve {
  const first = curve.t.findIndex((time) => time >= 0);
  return first < 0 ? { t: [], v: [] } : { t: curve.t.slice(first), v: curve.v.slice(first) };
}
