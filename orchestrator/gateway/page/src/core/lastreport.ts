/** What motion has shown last: of a running job, its last motion step; else the report of the job that ended last. */

import { effect, signal, untracked } from "@preact/signals";
import { get } from "./http.ts";
import type { JobShown, QueueState, StepReport } from "./model.ts";
import { jobs } from "./store.ts";
import { whenOpen } from "./stream.ts";

export const FINISHED = new Set(["done", "failed", "cancelled", "aborted", "interrupted"]);

export interface Report {
  id: string;
  name: string;
  state: string;
  reason: string;
  steps?: StepReport[];
}
export const lastReport = signal<Report | null>(null);

/** The last motion step of a report: the only kind that has a verdict. */
export function lastMotion(report: Report | null): StepReport | undefined {
  return report?.steps?.filter((step) => step.t0_fleet_ns !== null && step.t0_fleet_ns !== undefined).at(-1);
}

const LOAD_MS = 1000; // at most one report of a running job in this time
let loadedMs = -LOAD_MS;
let loadTimer = 0;

export function watchReports(): void {
  whenOpen(() => void loadNewest());
  let known = new Set<string>();
  let place = "";
  effect(() => {
    const all = Object.values(jobs.value);
    const ended = all.filter((job) => FINISHED.has(job.state));
    const fresh = ended.filter((job) => !known.has(job.job_id)).sort((a, b) => a.utc.localeCompare(b.utc));
    known = new Set(ended.map((job) => job.job_id));
    const newest = fresh.at(-1);
    if (newest) return untracked(() => void load(newest.job_id));
    const running = all.find((job) => !FINISHED.has(job.state) && job.state !== "queued");
    const now = running ? `${running.job_id} ${running.step} ${running.point ?? ""}` : "";
    if (running && now !== place && place.startsWith(running.job_id)) loadSoon(running.job_id);
    place = now;
  });
}

/** A step of a running job has ended: load what it has shown, not more often than it can be read. */
function loadSoon(id: string): void {
  clearTimeout(loadTimer);
  loadTimer = setTimeout(
    () => {
      loadedMs = performance.now();
      void load(id);
    },
    Math.max(0, loadedMs + LOAD_MS - performance.now()),
  );
}

async function loadNewest(): Promise<void> {
  const list = await get<QueueState>("jobs?limit=10");
  if (!("ok" in list)) return;
  const newest = list.ok.jobs?.find((job) => FINISHED.has(job.state));
  if (newest) await load(newest.id);
}

/** A report with a motion replaces the one before; one without leaves it, unless its job was not done. */
async function load(id: string): Promise<void> {
  const answer = await get<JobShown>(`jobs/${encodeURIComponent(id)}`);
  if (!("ok" in answer)) return;
  const { report, entry, last_motion: motion } = answer.ok;
  const before = lastReport.value;
  const running = entry && motion ? { id, name: entry.name, state: "running", reason: "", steps: [motion] } : null;
  const shown: Report | null = report ? { id, name: report.name, state: report.state, reason: report.reason, steps: report.steps ?? [] } : running;
  if (shown === null) return;
  if (shown.state === "running" && before?.id === id && before.state !== "running") return; // an older answer that comes late
  if (lastMotion(shown) || before === null || before.id === id || !["done", "running"].includes(shown.state)) lastReport.value = shown;
}
