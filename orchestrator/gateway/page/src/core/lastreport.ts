/** The report of the job that ended last: its evidence is what the start strip shows. */

import { effect, signal, untracked } from "@preact/signals";
import { get } from "./http.ts";
import type { JobReport, JobShown, QueueState, StepReport } from "./model.ts";
import { jobs } from "./store.ts";
import { whenOpen } from "./stream.ts";

export const FINISHED = new Set(["done", "failed", "cancelled", "aborted", "interrupted"]);
export const lastReport = signal<JobReport | null>(null);

/** The last motion step of a report: the only kind that has a verdict. */
export function lastMotion(report: JobReport | null): StepReport | undefined {
  return report?.steps?.filter((step) => step.t0_fleet_ns !== null && step.t0_fleet_ns !== undefined).at(-1);
}

export function watchReports(): void {
  whenOpen(() => void loadNewest());
  let known = new Set<string>();
  effect(() => {
    const ended = Object.values(jobs.value).filter((job) => FINISHED.has(job.state));
    const fresh = ended.filter((job) => !known.has(job.job_id)).sort((a, b) => a.utc.localeCompare(b.utc));
    known = new Set(ended.map((job) => job.job_id));
    const newest = fresh.at(-1);
    if (newest) untracked(() => void load(newest.job_id));
  });
}

async function loadNewest(): Promise<void> {
  const list = await get<QueueState>("jobs?limit=10");
  if (!("ok" in list)) return;
  const newest = list.ok.jobs?.find((job) => FINISHED.has(job.state));
  if (newest) await load(newest.id);
}

/** A report with a motion replaces the one before; one without leaves it. */
async function load(id: string): Promise<void> {
  const answer = await get<JobShown>(`jobs/${encodeURIComponent(id)}`);
  const report = "ok" in answer ? answer.ok.report : null;
  if (report && (lastMotion(report) || lastReport.value === null)) lastReport.value = report;
}
