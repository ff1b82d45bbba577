/** Approval of a proposed job: the plan is shown with its hash, and exactly that plan is released. */

import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { explain } from "../core/format.ts";
import { get, post } from "../core/http.ts";
import type { JobForecast, JobPlan, Preview, QueueEntry, Refusal } from "../core/model.ts";
import { accept, showNote } from "../core/notices.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { Act, closeDialog, Empty } from "./parts.tsx";
import { ForecastSteps, PreviewPlots } from "./preview.tsx";

interface Reviewed {
  plan: JobPlan;
  forecast?: JobForecast | null;
  dry_run?: JobForecast | null;
  preview?: Preview | null;
}

export function Approval({ job }: { job: QueueEntry }): JSX.Element {
  const [reviewed, setReviewed] = useState<Reviewed | null>(null);
  const [refused, setRefused] = useState<Refusal | null>(null);
  const load = (): void => {
    setReviewed(null);
    void get<Reviewed>(`jobs/${encodeURIComponent(job.id)}/plan`).then((answer) => {
      setRefused("refused" in answer ? answer.refused : null);
      if ("ok" in answer) setReviewed(answer.ok);
    });
  };
  useEffect(load, [job.id]);
  const plan = reviewed?.plan;
  const why = firstOf(whyNot("approve"), plan ? "" : T.approval.loading);
  const approve = async (): Promise<void> => {
    const answer = await post("approve", { job_id: job.id, plan: plan?.hash });
    if (accept(T.approval.of(job.name), answer) === null) return load(); // the plan may have changed: show what it is now
    closeDialog();
    showNote(T.approval.done(job.name));
  };
  const reject = async (): Promise<void> => {
    if (accept(T.approval.reject, await post("cancel", { job_id: job.id })) !== null) closeDialog();
  };
  return (
    <div class="approval">
      <p>{T.approval.by(job.actor)}</p>
      {job.reason ? <p class="reason">{onPage(job.reason)}</p> : null}
      {refused ? <p class="reason bad">{`▲ ${explain(refused)}`}</p> : null}
      {reviewed === null && refused === null ? <Empty text={T.approval.loading} /> : null}
      {reviewed?.preview ? <PreviewPlots preview={reviewed.preview} /> : null}
      <ForecastSteps forecast={reviewed?.forecast} dryRun={reviewed?.dry_run} />
      {plan ? (
        <details>
          <summary>
            {T.approval.plan} <code>{plan.hash}</code>
          </summary>
          <table class="plan">
            <tbody>
              {Object.entries(plan.parts ?? {}).map(([part, text]) => (
                <tr key={part}>
                  <th scope="row">{part}</th>
                  <td>{text}</td>
                </tr>
              ))}
            </tbody>
          </table>
        </details>
      ) : null}
      <p class="hint">{T.approval.hint}</p>
      <div class="row finish">
        <Act label={T.approval.release} kind="strong" motion why={why} onAct={() => void approve()} />
        <Act label={T.approval.reject} why={whyNot("cancel")} onAct={() => void reject()} />
      </div>
    </div>
  );
}
