/** The running job: progress, the stage of each member, and what the last motion step has shown. */

import type { JSX } from "preact";
import { computed } from "@preact/signals";
import { useState } from "preact/hooks";
import { formatSeconds, percent, shortId } from "../core/format.ts";
import { post } from "../core/http.ts";
import { FINISHED, lastMotion, lastReport } from "../core/lastreport.ts";
import { working } from "../core/manual.ts";
import type { JobProgress } from "../core/model.ts";
import { accept } from "../core/notices.ts";
import { whyNot } from "../core/rights.ts";
import { jobs, members } from "../core/store.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { RunAgain } from "./history.tsx";
import { PlotJob } from "./jobplot.tsx";
import { WorkLine } from "./jogpad.tsx";
import { Act, Empty, Panel, Progress } from "./parts.tsx";
import { StartStrip } from "./strip.tsx";
import { GoOn, programTexts } from "./submit.tsx";
import { BudgetTable, VerdictMark } from "./verdict.tsx";

export const runningJobs = computed(() => Object.values(jobs.value).filter((job) => !FINISHED.has(job.state) && job.state !== "queued"));

export function JobPanel(): JSX.Element {
  const running = runningJobs.value;
  return (
    <Panel title={T.job.title} area="job">
      {running.length === 0 ? working.value ? <WorkLine /> : <Empty text={T.job.none} /> : running.map((job) => <RunningJob key={job.job_id} job={job} />)}
      <LastVerdict />
    </Panel>
  );
}

function RunningJob({ job }: { job: JobProgress }): JSX.Element {
  const id = job.job_id;
  const send = (verb: string, body: object = {}): void => {
    void post(verb, { job_id: id, ...body }).then((answer) => accept(T.job.verb(verb, job.name), answer));
  };
  const paused = job.state === "paused";
  return (
    <article class="job" aria-label={T.job.name(job.name)}>
      <div class="rowhead">
        <b>{job.name}</b> <span>{T.jobState(job.state)}</span> <span class="quiet">{shortId(id)}</span>
        <span class="quiet">{job.actor}</span>
      </div>
      <Progress fraction={job.fraction} label={T.job.progress(job.name)} />
      <div class="facts num">
        <span>{percent(job.fraction)}</span>
        <span>
          {T.job.step(Math.min(job.step + 1, job.steps), job.steps)} {job.step_name}
        </span>
        {job.line ? <code>{`${T.submit.line(job.line)} ${programTexts[job.name]?.[job.line - 1] ?? ""}`}</code> : null}
        {job.point ? <span>{T.job.point(job.point, job.points ?? 0)}</span> : null}
        {typeof job.remaining_s === "number" ? <span>{T.job.remaining(formatSeconds(job.remaining_s))}</span> : null}
      </div>
      {job.reason ? <p class="reason">{onPage(job.reason)}</p> : null}
      <Stages id={id} />
      {typeof job.override_percent === "number" && !paused ? (
        <Override name={job.name} now={job.override_percent} onSet={(wanted) => send("override", { percent: wanted })} />
      ) : null}
      <div class="row">
        {job.armed ? <Act label={T.job.go} name={T.job.verb("go", job.name)} motion why={whyNot("go")} onAct={() => send("go")} /> : null}
        {paused ? (
          <Act label={T.job.resume} name={T.job.verb("resume", job.name)} motion why={whyNot("resume")} onAct={() => send("resume")} />
        ) : (
          <>
            <Act label={T.job.pause} name={T.job.verb("pause", job.name)} why={whyNot("pause")} onAct={() => send("pause", { now: false })} />
            <Act label={T.job.pauseNow} why={whyNot("pause")} onAct={() => send("pause", { now: true })} />
          </>
        )}
        <Act label={T.job.cancel} name={T.job.verb("cancel", job.name)} why={whyNot("cancel")} onAct={() => send("cancel")} />
        <PlotJob id={id} name={job.name} />
      </div>
    </article>
  );
}

const LEAST = 10;
const MOST = 120;

/** The speed along the path, in percent of the planned one. It is sent by Enter or the button, not on the way there. */
function Override({ name, now, onSet }: { name: string; now: number; onSet: (percent: number) => void }): JSX.Element {
  const [wanted, setWanted] = useState<number | null>(null);
  const value = wanted ?? now;
  const set = (): void => {
    setWanted(null);
    onSet(value);
  };
  return (
    <form
      class="row override"
      onSubmit={(event) => {
        event.preventDefault();
        if (whyNot("override") === "") set();
      }}
    >
      <label>
        <span>
          {T.job.override}: <b class="num">{percent(value / 100)}</b> <small>{T.job.overrideNow(percent(now / 100))}</small>
        </span>
        <input
          type="range"
          min={LEAST}
          max={MOST}
          step={5}
          value={value}
          aria-valuetext={percent(value / 100)}
          onInput={(event) => setWanted(Number(event.currentTarget.value))}
          onKeyDown={(event) => (event.key === "Enter" ? event.currentTarget.form?.requestSubmit() : undefined)}
        />
      </label>
      <Act label={T.job.overrideSet} name={T.job.verb("override", name)} kind="small" motion why={whyNot("override")} onAct={set} />
    </form>
  );
}

/** The stages of a member, in their order; any other mode is before the first. */
const STAGES = ["armed", "committed", "moving"];

function Stages({ id }: { id: string }): JSX.Element | null {
  const now = members.value[id];
  if (now === undefined) return null;
  return (
    <ul class="stages" aria-label={T.job.stages}>
      {Object.entries(now.members).map(([member, stage]) => (
        <li key={member}>
          <b>{member}</b>
          <span class="steps" aria-hidden="true">
            {STAGES.map((each) => (
              <i key={each} class={STAGES.indexOf(each) <= STAGES.indexOf(stage) ? "past" : ""} />
            ))}
          </span>
          <span>{T.mode(stage)}</span>
        </li>
      ))}
    </ul>
  );
}

function LastVerdict(): JSX.Element | null {
  const report = lastReport.value;
  const ended = report !== null && report.state !== "running";
  const good = report?.state === "done" || report?.state === "running";
  const step = lastMotion(report);
  if (report === null || (good && !step)) return null;
  return (
    <section class="last" aria-label={T.job.last}>
      <div class="rowhead">
        <span>{step ? T.job.lastStep(report.name, step.index + 1, step.name) : T.job.lastJob(report.name)}</span>
        {step ? <VerdictMark step={step} job={report.state} /> : null}
        {ended ? <PlotJob id={report.id} name={report.name} /> : null}
        {ended && !good ? <GoOn id={report.id} name={report.name} /> : null}
        {ended ? <RunAgain id={report.id} name={report.name} /> : null}
      </div>
      {good ? null : (
        <p class="reason">
          <b>{T.jobState(report.state)}</b>
          {report.reason ? `: ${onPage(report.reason)}` : ""}
        </p>
      )}
      {step ? <BudgetTable step={step} /> : null}
      {step ? <StartStrip step={step} /> : null}
      {(step?.deviations ?? []).map((text) => (
        <p class="reason" key={text}>
          {text}
        </p>
      ))}
    </section>
  );
}
