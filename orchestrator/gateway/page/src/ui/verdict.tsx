/** Verdict and budget of a step, side by side: what was promised, what is allowed, what the evidence says. */

import type { JSX } from "preact";
import { formatNs, formatSeconds } from "../core/format.ts";
import type { PredictedSkew, Skew, StepReport, SyncBudget } from "../core/model.ts";
import * as T from "../texts.ts";

const SIGNS = { green: "✓", amber: "◆", red: "✕", none: "–" };

/** The verdict of a step that was done; of any other step, its state. A job that did not get to its end has no green. */
export function VerdictMark({ step, job }: { step: StepReport; job: string }): JSX.Element {
  const { verdict } = step;
  const done = step.state === "done";
  if (!done || (verdict === "green" && job !== "done" && job !== "running"))
    return (
      <span class={`verdict ${done ? "none" : "broken"}`}>
        <span aria-hidden="true">{done ? SIGNS.none : "■"}</span> {T.jobState(step.state)}
      </span>
    );
  return (
    <span class={`verdict ${verdict}`}>
      <span aria-hidden="true">{SIGNS[verdict]}</span> {T.verdict[verdict]}
    </span>
  );
}

/** The verdict of a point of a scan; of a job that was not done, none is green. */
export function PointMark({ state, verdict, green }: { state: string; verdict: keyof typeof SIGNS; green: boolean }): JSX.Element {
  if (state !== "done")
    return (
      <span class="verdict broken">
        <span aria-hidden="true">■</span> {T.jobState(state)}
      </span>
    );
  if (verdict === "green" && !green) return <span class="verdict none">{T.history.within}</span>;
  return (
    <span class={`verdict ${verdict}`}>
      <span aria-hidden="true">{SIGNS[verdict]}</span> {T.verdict[verdict]}
    </span>
  );
}

export function BudgetTable({ step }: { step: StepReport }): JSX.Element {
  const { budget } = step;
  return (
    <table class="budget num">
      <thead>
        <tr>
          <th scope="col">{T.budget.what}</th>
          <th scope="col">{T.budget.predicted}</th>
          <th scope="col">{T.budget.allowed}</th>
          <th scope="col">{T.budget.measured}</th>
        </tr>
      </thead>
      <tbody>
        <BudgetRow name={T.budget.start} predicted={budget ? { ...budget } : null} measured={step.promised_skew ?? step.start_skew} />
        <BudgetRow name={T.budget.end} predicted={budget?.end} measured={step.end_skew} />
        <BudgetRow name={T.budget.path} predicted={budget?.path} measured={null} />
        <tr>
          <th scope="row">{T.budget.duration}</th>
          <td>{formatSeconds(step.planned_s)}</td>
          <td>–</td>
          <td>{formatSeconds(step.actual_s)}</td>
        </tr>
      </tbody>
    </table>
  );
}

function BudgetRow(props: { name: string; predicted: PredictedSkew | null | undefined; measured: Skew | null | undefined }): JSX.Element {
  const { predicted, measured } = props;
  return (
    <tr>
      <th scope="row">{props.name}</th>
      <td>{predicted ? `≤ ${formatNs(predicted.predicted_ns)}` : "–"}</td>
      <td>{predicted ? formatNs(predicted.allowed_ns) : "–"}</td>
      <td>{measured ? `${formatNs(measured.at_least_ns)} … ${formatNs(measured.at_most_ns)}` : "–"}</td>
    </tr>
  );
}

export function BudgetTerms({ budget }: { budget: SyncBudget }): JSX.Element {
  return (
    <details>
      <summary>{T.budget.terms(budget.worst_member, budget.worst_term)}</summary>
      <table class="num">
        <tbody>
          {Object.entries(budget.members).flatMap(([member, own]) =>
            own.terms.map((term) => (
              <tr key={`${member} ${term.name}`}>
                <th scope="row">{member}</th>
                <td>{term.name}</td>
                <td>
                  {formatNs(term.earliest_ns)} … {formatNs(term.latest_ns)}
                </td>
              </tr>
            )),
          )}
        </tbody>
      </table>
    </details>
  );
}
