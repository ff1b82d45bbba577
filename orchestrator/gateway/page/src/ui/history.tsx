/** Jobs that have ended: their reports, planned against actual, export, and running them again. */

import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { dayAndTime, explain, formatNs, formatSeconds, shortId } from "../core/format.ts";
import { get, newKey, post } from "../core/http.ts";
import { FINISHED, lastReport } from "../core/lastreport.ts";
import type { JobReport, JobShown, QueueEntry, QueueState, Recording, ScanSummary, StepReport } from "../core/model.ts";
import { accept, showNote } from "../core/notices.ts";
import { whyNot } from "../core/rights.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { PlotJob, RecordingPlot } from "./jobplot.tsx";
import { Act, closeDialog, Empty, openDialog, Panel } from "./parts.tsx";
import { PathFacts } from "./pathbound.tsx";
import { usePolled } from "./polled.ts";
import { ScanPoints } from "./scanpoints.tsx";
import { StartStrip } from "./strip.tsx";
import { GoOn } from "./submit.tsx";
import { BudgetTable, BudgetTerms, VerdictMark } from "./verdict.tsx";

const REFRESH_MS = 5000;

export function HistoryPanel(): JSX.Element {
  const [state, setState] = useState("");
  const [name, setName] = useState("");
  const query = new URLSearchParams({ limit: "50", ...(state ? { state } : {}), ...(name ? { name } : {}) });
  const list = usePolled<QueueState>(`jobs?${query.toString()}`, REFRESH_MS);
  const ended = list?.jobs?.filter((job) => FINISHED.has(job.state));
  return (
    <Panel
      title={T.history.title}
      area="history"
      tools={
        <div class="chips">
          <select aria-label={T.history.state} value={state} onChange={(event) => setState(event.currentTarget.value)}>
            <option value="">{T.history.anyState}</option>
            {[...FINISHED].map((each) => (
              <option key={each} value={each}>
                {T.jobState(each)}
              </option>
            ))}
          </select>
          <input type="search" aria-label={T.history.name} placeholder={T.history.name} value={name} onInput={(event) => setName(event.currentTarget.value)} />
        </div>
      }
    >
      {ended === undefined ? <Empty text={T.loading} /> : ended.length === 0 ? <Empty text={T.history.none} /> : null}
      <table>
        <tbody>
          {ended?.map((job) => (
            <tr key={job.id}>
              <td class="num when">{dayAndTime(job.submitted_utc)}</td>
              <th scope="row">
                <button type="button" class="link" onClick={() => openDialog(T.history.of(job.name), <JobDetails job={job} />, true)}>
                  {job.name}
                </button>
              </th>
              <td class="quiet">{shortId(job.id)}</td>
              <td>{T.jobState(job.state)}</td>
              <td class="quiet">{onPage(job.reason)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </Panel>
  );
}

function JobDetails({ job }: { job: QueueEntry }): JSX.Element {
  const [report, setReport] = useState<JobReport | null>(null);
  useEffect(() => {
    void get<JobShown>(`jobs/${encodeURIComponent(job.id)}`).then((answer) => setReport(accept(T.history.of(job.name), answer)?.report ?? null));
  }, [job.id]);
  if (report === null) return <Empty text={T.loading} />;
  return (
    <div>
      <p class="facts num">
        <span>{job.id}</span>
        <span>{report.actor}</span>
        <span>{T.jobState(report.state)}</span>
        <span>{dayAndTime(report.started_utc)}</span>
        <span>{dayAndTime(report.ended_utc)}</span>
      </p>
      {report.reason ? <p class="reason">{onPage(report.reason)}</p> : null}
      <div class="row">
        <a class="act" href={`v1/jobs/${encodeURIComponent(job.id)}/export.csv`} download>
          {T.history.export}
        </a>
        <PlotJob id={job.id} name={job.name} />
        {report.state === "done" ? null : <GoOn id={job.id} name={job.name} />}
        <Retry job={job} steps={report.steps?.length ?? 1} />
      </div>
      {report.steps?.map((step) => (
        <StepDetails key={step.index} job={job.id} state={report.state} step={step} />
      ))}
    </div>
  );
}

function StepDetails({ job, state, step }: { job: string; state: string; step: StepReport }): JSX.Element {
  const [recording, setRecording] = useState<Recording | null>(null);
  const moved = step.t0_fleet_ns !== null && step.t0_fleet_ns !== undefined;
  const load = async (): Promise<void> => {
    setRecording(accept(T.history.recording, await get<Recording>(`jobs/${encodeURIComponent(job)}/recording/${step.index}`)));
  };
  return (
    <section class="stepdetails">
      <div class="rowhead">
        <b>{T.history.step(step.index + 1, step.name || step.do)}</b> <span>{step.state}</span>
        {moved && step.state === "done" ? <VerdictMark step={step} job={state} /> : null} <span class="quiet num">{formatSeconds(step.actual_s)}</span>
        {moved && recording === null ? <Act label={T.history.recording} kind="small" onAct={() => void load()} /> : null}
      </div>
      {step.reason ? <p class="reason">{onPage(step.reason)}</p> : null}
      {step.refused ? <p class="reason bad">{`▲ ${explain(step.refused)}`}</p> : null}
      {(step.deviations ?? []).map((text) => (
        <p class="reason" key={text}>
          {text}
        </p>
      ))}
      {step.path ? <PathFacts path={step.path} /> : null}
      {step.scan ? <ScanDetails scan={step.scan} green={state === "done" && step.state === "done"} /> : null}
      {step.scan ? <ScanPoints job={job} step={step.index} scan={step.scan} green={state === "done" && step.state === "done"} /> : null}
      {moved ? (
        <details>
          <summary>{T.history.evidence}</summary>
          <BudgetTable step={step} />
          <StartStrip step={step} />
          {step.budget ? <BudgetTerms budget={step.budget} /> : null}
        </details>
      ) : null}
      {recording ? <RecordingPlot recording={recording} /> : null}
    </section>
  );
}

function ScanDetails({ scan, green }: { scan: ScanSummary; green: boolean }): JSX.Element {
  return (
    <>
      <p class="facts num">
        <span>{T.history.scan(scan.done, scan.points)}</span>
        {Object.entries(scan.verdicts ?? {}).map(([verdict, count]) => (
          <span key={verdict}>{T.history.verdicts(count, verdict === "green" && !green ? T.history.within : verdict)}</span>
        ))}
        {typeof scan.start_skew_worst_ns === "number" ? <span>{T.history.worstStart(formatNs(scan.start_skew_worst_ns))}</span> : null}
        {typeof scan.mean_s === "number" ? (
          <span>{T.history.perPoint(formatSeconds(scan.least_s), formatSeconds(scan.mean_s), formatSeconds(scan.most_s))}</span>
        ) : null}
      </p>
      {(scan.not_green ?? []).map((finding) => (
        <p class="reason" key={finding.point}>
          {T.history.pointFinding(finding.point, finding.verdict, onPage(finding.text))}
        </p>
      ))}
    </>
  );
}

interface Retried {
  job_id?: string;
  steps?: string[];
  warnings?: string[];
  axes?: { axis: string; unit: string; position: number | null }[];
}

/** Run the job that ended last again; it is shown at once what that would be. */
export function RunAgain({ id, name }: { id: string; name: string }): JSX.Element {
  const steps = lastReport.value?.steps?.length || 1;
  return <Act label={T.history.retry} name={T.history.retryOf(name)} kind="small" why={whyNot("retry")} onAct={() => openDialog(T.history.retryOf(name), <Retry job={{ id, name }} steps={steps} atOnce />)} />;
}

/** Run a job again, from one of its steps on; first it is shown what that would be. */
function Retry({ job, steps, atOnce = false }: { job: { id: string; name: string }; steps: number; atOnce?: boolean }): JSX.Element {
  const [from, setFrom] = useState(0);
  const [asked, setAsked] = useState<Retried | null>(null);
  useEffect(() => {
    if (atOnce) void look();
  }, []);
  const why = whyNot("retry");
  const body = { job_id: job.id, from_step: from };
  const look = async (): Promise<void> => setAsked(accept(T.history.retry, await post<Retried>("retry", { ...body, client_key: newKey(), dry_run: true })));
  const run = async (): Promise<void> => {
    const key = newKey();
    if (accept(T.history.retry, await post<Retried>("retry", { ...body, client_key: key, dry_run: false }, key)) === null) return;
    closeDialog();
    showNote(T.submit.submitted(job.name));
  };
  return (
    <>
      <label class="inline">
        {T.history.fromStep}
        <select
          value={from}
          onChange={(event) => {
            setFrom(Number(event.currentTarget.value));
            setAsked(null);
          }}
        >
          {Array.from({ length: steps }, (_, index) => (
            <option key={index} value={index}>
              {index + 1}
            </option>
          ))}
        </select>
      </label>
      <Act label={T.history.retry} why={why} onAct={() => void look()} />
      {asked ? (
        <div class="retry">
          <ol>
            {(asked.steps ?? []).map((text, index) => (
              <li key={index}>{text}</li>
            ))}
          </ol>
          {(asked.warnings ?? []).map((text) => (
            <p class="reason bad" key={text}>{`▲ ${text}`}</p>
          ))}
          <Act label={T.history.retryNow} kind="strong" motion why={why} onAct={() => void run()} />
        </div>
      ) : null}
    </>
  );
}
