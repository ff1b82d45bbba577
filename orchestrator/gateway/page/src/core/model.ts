/** What the gateway sends: names as on the bus. A field that is absent has no value. */

export type Role = "viewer" | "proposer" | "operator" | "maintainer";

export interface Session {
  fleet: string;
  version: string;
  user: string | null;
  role: Role;
  users: boolean;
  csrf: string;
  may: string[];
}

export interface Refusal {
  code: string;
  text: string;
  remedy?: string;
  controller?: string | null;
  member?: string | null;
}

export interface Fault {
  code: string;
  text: string;
  remedy: string;
  axis?: string | null;
}

export interface AxisState {
  position?: number;
  commanded?: number;
  velocity?: number;
  target?: number;
  unit: string;
  moving: boolean;
  homing?: boolean;
  enabled: boolean;
  referenced: boolean;
  limit?: "none" | "forward" | "reverse" | "both";
  fault?: string | null;
  offset?: string;
  min?: number;
  max?: number;
  max_velocity?: number;
  jog_velocity?: number;
  /** The part of `max_velocity` for what a person asks for one at a time. */
  manual_speed?: number;
}

export interface ClockQuality {
  bound_ns: number;
  age_ns: number;
  samples: number;
}

export interface LinkTotals {
  bytes_out: number;
  bytes_in: number;
  errors?: number;
}

export interface Estop {
  event: string;
  actor: string;
  reason: string;
  utc: string;
}

export interface ControllerState {
  mode: string;
  age_s?: number;
  present: boolean;
  make?: string;
  /** Of a group of virtual axes: the real axes that it stands for. */
  of?: string[];
  epoch?: number;
  digest?: string;
  job?: string;
  step?: number;
  faults?: Fault[];
  estop?: Estop;
  inputs?: Record<string, boolean>;
  outputs?: Record<string, boolean>;
  clock?: ClockQuality;
  link?: LinkTotals;
  axes: Record<string, AxisState>;
}

export interface Lease {
  holder: string;
  actor: string;
  what: string;
  until_utc?: string;
}

export interface Permit {
  name: string;
  axes: string[];
  text: string;
}

export interface QueueTerms {
  priority?: number;
  repeat?: number;
  after?: string | null;
  at?: string | null;
  missed?: "run" | "skip";
  held?: boolean;
  expires?: string | null;
  continues?: string | null;
}

export interface QueueEntry {
  id: string;
  name: string;
  actor: string;
  state: string;
  reason: string;
  submitted_utc: string;
  place?: number | null;
  terms?: QueueTerms;
  held_by?: string;
  origin?: string | null;
  from_step?: number;
  proposed?: boolean;
  /** What it had to wait for is gone; its start has to be asked for. */
  ready?: boolean;
}

/** What a job does first. */
export interface FirstMotion {
  job_id: string;
  name: string;
  text: string;
  axes?: string[];
  cause?: string;
}

/** What would move first; `shown` stands for exactly this in the word for it. */
export interface StartPreview {
  motions?: FirstMotion[];
  lasting?: FirstMotion[];
  shown: string;
}

export interface QueueStop {
  reason: string;
  actor: string;
  utc: string;
}

export interface QueueState {
  stopped?: QueueStop | null;
  journal?: string;
  waiting?: number;
  total?: number;
  jobs?: QueueEntry[];
}

export interface JobProgress {
  job_id: string;
  name: string;
  actor: string;
  state: string;
  step: number;
  steps: number;
  step_name: string;
  point?: number | null;
  points?: number | null;
  fraction: number;
  remaining_s?: number | null;
  /** The line that runs of the file of its path. */
  line?: number | null;
  override_percent?: number | null;
  /** Its motion is loaded, and waits. */
  armed?: object | null;
  reason: string;
  utc: string;
  ready?: boolean;
}

export interface Members {
  step: number;
  members: Record<string, string>;
}

export interface Alarm {
  id: string;
  kind: string;
  subject: string;
  priority: string;
  text: string;
  action: string;
  state: "unacknowledged" | "acknowledged" | "returned" | "normal";
  raised_utc: string;
  returned_utc?: string | null;
  acknowledged_by?: string | null;
  acknowledged_utc?: string | null;
  shelved_until_utc?: string | null;
  shelved_by?: string | null;
  shelved_why?: string;
  out_of_service?: string;
  count?: number;
}

export interface FleetEvent {
  n: number;
  controller: string;
  kind: string;
  text: string;
  utc: string;
  job?: string | null;
  step?: number | null;
}

export interface LastStop {
  by: string;
  what: string;
  utc?: string;
}

/** A camera of the machine, of the fleet file. */
export interface WebView {
  title: string;
  url: string;
  kind: "image" | "page";
}

/** How many controllers are in which mode, and the first names of those in each trouble. */
export interface Counts {
  configured: number;
  controllers: number;
  modes: Record<string, number>;
  troubles: Record<string, number>;
  troubled: Record<string, string>;
}

export interface State {
  fleet: string;
  utc: string;
  fleet_s?: number;
  coordinator: { present: boolean; name?: string; epoch?: number };
  counts?: Counts;
  controllers?: Record<string, ControllerState>;
  virtual?: Record<string, ControllerState>;
  leases?: Record<string, Lease>;
  permits?: Permit[];
  queue?: QueueState;
  jobs?: Record<string, JobProgress>;
  members?: Record<string, Members>;
  /** Of a job whose running step is a path: its index, from 0, and its axes. */
  paths?: Record<string, { step: number; axes: string[] }>;
  alarms?: Record<string, Alarm>;
  events?: FleetEvent[];
  last_stop?: LastStop;
  views?: WebView[];
}

export interface Work {
  id: number;
  state: string;
  job_id?: string;
  reason?: string;
  remedy?: string;
  fraction?: number;
}

export interface Stopped extends LastStop {
  answers?: Record<string, Refusal | null>;
}

/** An answer of the gateway: what it has done, or why not. */
export type Answer<T = Record<string, unknown>> = { ok: T } | { refused: Refusal };

export interface Interval {
  earliest_ns: number;
  latest_ns: number;
}

export interface Skew {
  at_least_ns: number;
  at_most_ns: number;
}

export interface BudgetTerm extends Interval {
  name: string;
}

export interface PredictedSkew {
  predicted_ns: number;
  allowed_ns?: number | null;
  worst_member: string;
}

export interface SyncBudget {
  predicted_ns: number;
  allowed_ns: number;
  worst_member: string;
  worst_term: string;
  members: Record<string, Interval & { terms: BudgetTerm[] }>;
  end?: PredictedSkew | null;
  path?: PredictedSkew | null;
}

export interface AxisEvidence {
  start: Interval;
  modelled?: Interval | null;
  late_ns?: number;
}

export interface MemberReport {
  start_class: string;
  axes: string[];
  evidence?: Record<string, AxisEvidence>;
}

export interface ScanSummary {
  points: number;
  done: number;
  verdicts?: Record<string, number>;
  start_skew_worst_ns?: number | null;
  not_green?: { point: number; verdict: string; text: string }[];
  least_s?: number | null;
  mean_s?: number | null;
  most_s?: number | null;
}

export interface PathBound {
  tolerance: number;
  predicted: number;
  proven?: number | null;
  terms: { name: string; member?: string; size: number }[];
}

export interface PathReport {
  unit: string;
  frame?: string;
  length: number;
  duration_s: number;
  bound?: PathBound | null;
}

export interface StepReport {
  index: number;
  do: string;
  name: string;
  state: string;
  reason?: string;
  planned_s?: number | null;
  actual_s?: number | null;
  t0_fleet_ns?: number | null;
  members?: Record<string, MemberReport>;
  budget?: SyncBudget | null;
  start_skew?: Skew | null;
  promised_skew?: Skew | null;
  end_skew?: Skew | null;
  verdict: "green" | "amber" | "red" | "none";
  deviations?: string[];
  refused?: Refusal | null;
  scan?: ScanSummary | null;
  path?: PathReport | null;
  feed_holds?: { by: string; utc: string }[];
}

export interface JobReport {
  job_id: string;
  parameters_used?: Record<string, string>;
  name: string;
  actor: string;
  state: string;
  reason: string;
  submitted_utc: string;
  started_utc?: string | null;
  ended_utc?: string | null;
  max_start_skew_ns: number;
  steps?: StepReport[];
}

export interface JobShown {
  entry?: QueueEntry | null;
  job?: { steps?: unknown } | null;
  report?: JobReport | null;
  progress?: JobProgress | null;
  /** Of a running job: its last motion step that has ended. */
  last_motion?: StepReport | null;
}

export interface Curve {
  t: number[];
  v: number[];
}

export interface Recording {
  t0_fleet_ns: number;
  axes: Record<string, { unit: string; planned: Curve; actual: Curve }>;
}

/** All motion steps of a job over the seconds after T0 of the first. */
export interface JobCurves {
  steps: { index: number; name: string; text: string; t0: number; t1: number }[];
  axes: Recording["axes"];
  left_out: number;
}

export interface ScanPoint {
  step: number;
  point: number;
  state: string;
  verdict: "green" | "amber" | "red" | "none";
  target: Record<string, number>;
  measured: Record<string, number | null>;
  start_skew?: Skew | null;
  took_s?: number | null;
}

export interface Preview {
  duration_s: number;
  steps: { index: number; text: string; t0: number; t1: number }[];
  axes: Record<string, Curve & { unit: string }>;
  unknown?: string | null;
}

export interface StepForecast {
  index: number;
  do: string;
  text: string;
  least_s?: number;
  most_s?: number | null;
  conditions?: string[];
  budget?: SyncBudget | null;
  path?: PathReport | null;
}

export interface JobForecast {
  steps?: StepForecast[];
  problems?: { place?: (string | number)[]; text: string; remedy?: string; controller?: string | null }[];
  conditions?: string[];
}

export interface JobPlan {
  hash: string;
  parts?: Record<string, string>;
}

export interface Parameter {
  name: string;
  type: string;
  unit?: string;
  default?: unknown;
  min?: unknown;
  max?: unknown;
  choices?: string[] | null;
  description?: string;
  required?: boolean;
}

export interface Template {
  name: string;
  file: string;
  description?: string;
  parameters: Parameter[];
  /** How the fleet offers it as a button. */
  button?: { label: string; group?: string | null } | null;
  /** Why its job cannot be submitted, in words. */
  problem?: string | null;
}

/** A program, or the rest of a job. */
export interface CheckedProgram {
  /** What was chosen, as it is to stay after what comes first. */
  values: Record<string, string>;
  /** What comes first, in words: the move to its place, while the axes are not there. */
  approach: string;
  confirm: string[];
  /** The words over what is to be confirmed, for it, and on the button of what comes first. */
  title: string;
  sure: string;
  act: string;
  /** What its job is submitted with, besides the form. */
  terms: QueueTerms;
  /** The rest of a scan: it is run again from its point. */
  retry: Record<string, unknown> | null;
  notes: string[];
  extents: { axis: string; unit: string; min: number; max: number; limits: number[] | null; over: number }[];
  drawing: { axes: string[]; rapid: string; feed: string; start: number[] | null };
}

export interface Checked {
  program?: CheckedProgram;
  problems?: { line?: number | null; place?: string; text: string }[];
  parameters?: Parameter[];
  job?: Record<string, unknown> | null;
  forecast?: JobForecast | null;
  preview?: Preview | null;
  dry_run?: JobForecast | null;
}

export interface NamedPosition {
  name: string;
  axes: Record<string, string | number>;
  description?: string;
  source: string;
  actor?: string;
  utc?: string;
  problems?: string[];
}

export interface WireFinding {
  output: string;
  input: string;
  ok: boolean;
  text: string;
  remedy?: string;
}
