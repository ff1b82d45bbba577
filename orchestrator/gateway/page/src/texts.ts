/**
 * All texts of the page, in one catalogue.
 *
 * Messages say what is, and what to do. Tests find parts of the page by role and by these names:
 *   region "Stop bar" with buttons "Stop" and "E-stop"; navigation "Views" with "Run", "Set-up", "Service";
 *   region "Axes" with `axis-gantry.x` and `position-gantry.x` (data-testid), buttons "Go: gantry.x", "Menu of gantry.x";
 *   region "Jog" with group "Jog pad" (arrow keys) and buttons "Jog gantry.x +" and "Jog gantry.x −";
 *   region "Queue …" with list "Waiting jobs", whose items have `data-job`; status "State of the fleet";
 *   region "Running job" with progressbar "Progress of …"; button "Alarms …"; dialog, by its title.
 */

import REMEDIES from "./remedies.json";

const s = (count: number): string => (count === 1 ? "" : "s");

const MODES: Record<string, string> = {
  absent: "no adapter",
  offline: "offline",
  idle: "idle",
  armed: "armed",
  committed: "committed",
  moving: "moving",
  jogging: "jogging",
  homing: "homing",
  stopping: "stopping",
  fault: "fault",
};

/**
 * Both forms of what remedies name, in `remedies.json`: the words of the terminal, and what they are on the page. `*` is
 * the rest of a command. The longest that fits counts; a test holds every text of the product against it.
 */
const ON_PAGE = [...REMEDIES].sort(([a = ""], [b = ""]) => b.length - a.length).map(([terminal = "", page = ""]): [RegExp, string] => [
  new RegExp(terminal.replace(/[.?()[\]{}+^$|\\]/g, "\\$&").replaceAll("*", "[^`]*"), "g"),
  page,
]);
/** Of an older report, or of an adapter of another origin. */
const UNKNOWN = /`tutti [^`]*`/g;

/** A message of the fleet, with the names of the page for commands of the terminal. */
export function onPage(text: string): string {
  if (!text.includes("`tutti ") && !text.includes("`--")) return text;
  return ON_PAGE.reduce((now, [terminal, page]) => now.replace(terminal, page), text).replace(UNKNOWN, elsewhere);
}

/** Places in job files count from 0, steps that people read from 1. */
export function placeOnPage(place: string): string {
  return place.replace(/\bsteps[.[](\d+)\]?/g, (_, index: string) => `step ${Number(index) + 1}`).replace(/^(step \d+)\./, "$1, ");
}


export const loading = "Loading …";
export const elsewhere = "the terminal of the computer of the fleet";
export const close = "Close";
export const dismiss = "Dismiss";
export const controller = "Controller";
export const age = (seconds: number) => `${seconds} s old`;
export const mode = (mode: string) => MODES[mode] ?? mode;
export const jobState = (state: string) => state;

export const title = {
  alarms: (count: number) => `▲ ${count} alarm${s(count)} · `,
  away: "No connection ·",
};

export const view = {
  nav: "Views",
  names: { run: "Run", setup: "Set-up", service: "Service" },
  locked: "The view stays",
  lockedRemedy: "An axis is under manual control of this page. Let go and release it first.",
};

export const role = { viewer: "viewer", proposer: "proposer", operator: "operator", maintainer: "maintainer" };
export const user = { none: "no users", signOut: "Sign out" };

export const settings = {
  title: "Settings and keys",
  theme: "Colours",
  themes: { auto: "As the system", light: "Light", dark: "Dark" },
  sound: "Sound while an alarm is not acknowledged",
  version: (version: string) => `Tutti ${version}`,
};

export const keys = {
  title: "Keys",
  inDialog: (key: string) => `Esc closes this; ${key ? `Pause or ${key}` : "Pause"} stops.`,
  key: "Key",
  where: "Where",
  what: "What it does",
  table: (key: string): [string, string, string][] => [
    [key ? `Pause, ${key}` : "Pause", "everywhere", "Stop; nothing else"],
    ["Esc", "a dialog, list or calendar is open, or a card is dragged", "closes it; stops nothing"],
    ["Esc", "nothing is open", "Stop"],
    ["arrow keys", "the jog pad has the focus", "jog: as long as they are held, or one step"],
    ["arrow keys", "a slider, a list or a text has the focus", "change the value; move nothing"],
    ["+ and -", "the jog pad has the focus", "speed of the jog"],
    ["Enter", "a button has the focus", "presses it"],
    ["Enter", "a text or a slider has the focus", "sends its form, if it has one"],
    ["space bar", "a button has the focus", "presses it, unless it moves something"],
    ["Tab", "everywhere", "the next button; in Set-up first the jog pad"],
  ],
  choose: "Also stops, always",
  none: "only Pause",
  names: (key: string) => (key === "ScrollLock" ? "Scroll Lock" : key),
};

export const login = {
  title: "Sign in",
  user: "User",
  password: "Password",
  signIn: "Sign in",
  stopHint: "To stop without signing in, use the E-stop button of the machine, or a page that is signed in",
  stop: "Stop",
  stopped: "All controllers have stopped",
  notStopped: (names: string[]) => `${names.join(", ")} did not confirm the stop: use the E-stop button of the machine`,
};

export const link = {
  fresh: (time: string) => time,
  old: (seconds: number) => `no news for ${seconds} s`,
  lost: (seconds: number) => `not connected, ${seconds} s old`,
  noCoordinator: "no coordinator",
};

export const messages = {
  title: "Messages",
  none: "No messages.",
  more: (count: number) => `${count} more`,
  lost: (seconds: number) =>
    `No connection to the gateway: what is shown is ${seconds} s old. It connects again by itself. Stop is still tried; if in doubt, use the E-stop button of the machine.`,
  noCoordinator: "The coordinator is away: jobs, homing and jogging wait for it. Stop and E-stop work. It is started again on the computer of the fleet.",
  estop: (controllers: string, actor: string, reason: string, time: string) =>
    `E-stop of ${controllers} by ${actor} at ${time} UTC${reason ? `: ${reason}` : ""}. Remove the cause, then reset.`,
  fault: (controllers: string) => `Fault of ${controllers}: the table of axes says which. Remove the cause, then reset; nothing moves by that.`,
  stopped: (what: string, by: string, time: string) => `${what === "estop" ? "E-stop" : "Stopped"} by ${by} at ${time} UTC`,
  noUsers: "There are no users: everyone on this machine is an operator. Users are added on the computer of the gateway.",
};

export const refusal = {
  noConnection: "There is no connection to the gateway.",
  noConnectionRemedy: "Wait until the page is connected again; it tries by itself.",
  status: (status: number) => `The gateway answered with status ${status}.`,
  statusRemedy: "Try again; if it remains, look at the log of the gateway.",
};

export const why = {
  cannot: (what: string) => `Not now: ${what}`,
  noConnection: "there is no connection to the gateway",
  stale: (seconds: number) => `what is shown is ${seconds} s old; wait until it is fresh`,
  role: (role: string) => `the role ${role} may not do this; ask a maintainer for another role`,
  noCoordinator: "the coordinator is away; it is started on the computer of the fleet",
  unknownController: (id: string) => `there is no controller ${id}`,
  noAdapter: (id: string) => `the adapter of ${id} does not answer; start its adapter host`,
  oldController: (id: string, seconds: number) => `the state of ${id} is ${seconds} s old; look at its link in Service`,
  offline: (id: string) => `${id} is offline; look at its power and cable`,
  estop: (id: string) => `${id} has an E-stop; reset it first`,
  working: (words: string) => `first wait for this, or stop it: ${words}`,
  held: (axis: string, job: string) => `${axis} is held by the job ${job}; wait for its end, or stop it`,
  disabled: (axis: string) => `the motor of ${axis} is off; enable it first`,
  noJog: (axis: string) => `${axis} cannot be jogged now: its real axes cannot, or it would leave its curve`,
};

export const stop = {
  bar: "Stop bar",
  label: { stop: "Stop", estop: "E-stop" },
  title: { stop: "Stop all axes by their ramps (Pause; Esc, while nothing is open)", estop: "Stop all axes as fast as they can, and latch" },
  estopReason: "pressed on the operators' page",
  failed: { stop: "The stop was not sent", estop: "The E-stop was not sent" },
  failedRemedy: "Use the E-stop button of the machine now.",
  notStopped: (controller: string) => `${controller} has not confirmed the stop`,
  reset: "Reset",
  resetRefused: "Not reset",
  resetDone: "Reset: E-stops are released, and faults cleared",
};

export const fleet = {
  state: "State of the fleet",
  estop: (names: string) => `E-stop: ${names}`,
  absent: (names: string) => `no adapter: ${names}`,
  offline: (names: string) => `offline: ${names}`,
  fault: (names: string) => `fault: ${names}`,
  permit: (names: string) => `permit missing: ${names}`,
  running: (name: string) => `running: ${name}`,
  moving: (names: string) => `moving: ${names}`,
  queueStopped: "idle, the queue is stopped",
  idle: "idle",
};

export const axes = {
  title: "Axes",
  none: "No axes yet. They appear as soon as the coordinator and the adapters answer.",
  axis: "Axis",
  position: "Position",
  target: "Target",
  state: "State and remedy",
  holder: "Holder",
  menu: "Menu",
  menuOf: (axis: string) => `Menu of ${axis}`,
  menuTitle: (axis: string) => `Axis ${axis}`,
  plot: (axis: string) => `Plot ${axis}`,
  you: "this page",
  heldByJob: (job: string) => `job ${job}`,
  now: "Now at",
  offset: (offset: string) => `(offset ${offset})`,
  enable: (axis: string) => `Enable ${axis}`,
  disable: (axis: string) => `Disable ${axis}`,
  home: (axis: string) => `Home ${axis}`,
  homeHint: "The axis moves to find its reference. Its way must be free.",
  valueLabel: (unit: string) => `Position in ${unit}`,
  typeNumber: "type a position first",
  beyond: (axis: string, value: string, limit: string) => `${axis}: ${value} is beyond the soft limit ${limit}`,
  go: "Go",
  goOf: (axis: string) => `Go: ${axis}`,
  goTo: (value: string) => `Go to ${value}`,
  limits: (min: string, max: string) => `soft limits ${min} … ${max}`,
  noLimits: "no soft limits",
  stepLabel: (axis: string) => `Step of ${axis}`,
  stepBy: (axis: string, distance: string) => `Step ${axis} by ${distance}`,
  stepHint: "One step for each press, from where it stands.",
  moving: (axis: string) => `Move ${axis}`,
  setTo: (value: string) => `Set the present position to ${value}`,
  setting: (axis: string) => `Set the position of ${axis}`,
  removeOffset: "Remove the offset",
  standsFor: (axes: string) => `Virtual: its motors and references are those of ${axes}.`,
  setHint: "Setting a position moves nothing: it changes what the present position is called.",
};

export const speed = {
  label: "Speed",
  means: (speed: string) => `at most ${speed}`,
  unread: (example: string) => `write a speed as ${example}, 50 % or 0.5`,
  outside: "a percentage of the limit is above 0 to 100 %",
  noUnit: (text: string, example: string) => `${text} without a unit is a part of the limit, above 0 to 1; with one it is a speed: ${example}`,
  zero: "a speed is above 0",
  above: (limit: string) => `the limit of this axis is ${limit}; choose a lower speed`,
};

export const start = {
  begin: "Begin …",
  beginOf: (name: string) => `Begin ${name}`,
  first: "This moves first",
  nothing: "Nothing moves now.",
  lasting: "These still wait",
  axes: (axes: string) => `moves ${axes}`,
  waitedFor: (cause: string) => `had to wait: ${cause}`,
  waitsFor: (cause: string) => `waits for: ${cause}`,
  confirm: "Begin now",
  again: "Look again",
  cancel: "Not now",
  busy: "it is being sent",
  lasts: "what it waits for is still there",
  unseen: "look at what moves first",
  changed: "It was not begun: what moves first has changed. This is what it is now.",
  ready: "ready to begin",
  readyJobs: (names: string[]) => `Ready to begin: ${names.slice(0, 3).join(", ")}${names.length > 3 ? ` and ${names.length - 3} more` : ""}.`,
  queueStopped: (waiting: number) => `The queue is stopped; ${waiting === 1 ? "1 job waits" : `${waiting} jobs wait`}.`,
};

export const ready = {
  get: "Get ready …",
  title: "Get ready",
  toEnable: (axes: string) => `Enable the motors of ${axes}.`,
  toHome: (axes: string) => `Then home ${axes}.`,
  homeHint: "Axes that are homed move to find their references, in the order of the fleet. Their way must be free.",
  allReady: "Every axis that is needed is enabled and referenced.",
  confirm: (enable: boolean, home: boolean) => (enable && home ? "Enable and home these" : home ? "Home these" : "Enable these"),
  ok: "ready",
  moving: "moving",
  homing: "homing",
  noAdapter: "no adapter",
  noAdapterRemedy: (controller: string) => `start the adapter host of ${controller}`,
  offline: "offline",
  offlineRemedy: "look at power and cable; the adapter connects again by itself",
  estop: (actor: string) => `E-stop by ${actor}`,
  estopRemedy: "remove the cause, then reset",
  faultRemedy: "look at the alarms",
  limit: (limit: string) => (limit === "both" ? "at both limit switches" : `at the ${limit} limit switch`),
  limitRemedy: "jog it away from the switch",
  permit: (name: string) => `permit ${name} is missing`,
  disabled: "motor off",
  disabledRemedy: "enable it",
  unreferenced: "not referenced",
  unreferencedRemedy: "home it",
};

export const jog = {
  title: "Jog",
  pad: "Jog pad",
  name: (axis: string) => `Jog ${axis}`,
  plus: (axis: string) => `Jog ${axis} +`,
  minus: (axis: string) => `Jog ${axis} −`,
  step: (axis: string, distance: string) => `Step ${axis} by ${distance}`,
  across: "Left and right",
  upwards: "Up and down",
  noAxis: "none",
  motion: "Motion for each press",
  hold: "Hold to run",
  holdHint: "Hold a button, or an arrow key while the pad has the focus. It stops when you let go.",
  stepHint: "Each press of a button, or of an arrow key while the pad has the focus, is one step.",
  speed: "Speed",
  speedNow: (speed: string) => `${speed}/s`,
  limits: "Place between the soft limits",
  release: (axes: string) => `Release ${axes}`,
  refused: (axis: string) => `Jog of ${axis}`,
  ended: (axis: string) => `The jog of ${axis} has ended`,
  noAnswer: "The gateway did not answer in time. Press again.",
  socketClosed: "The connection to the gateway was lost. The axis stops by itself within 200 ms and its ramp.",
  lost: "Manual control has ended",
};

export const pad = {
  title: "Gamepad",
  use: "Use a gamepad",
  noApi: "this browser gives pages no gamepads; open the page by https, or on the computer of the gateway",
  none: "No gamepad is seen. Connect it, and press one of its buttons: until then browsers hide it.",
  deadMan: "Button to hold",
  button: (number: number) => `button ${number + 1}`,
  stick: { across: "Stick for left and right", upwards: "Stick for up and down" },
  axis: (number: number) => `axis ${number + 1}`,
  reversed: "reversed",
  deadZone: "Dead zone",
  now: { across: "Left and right", upwards: "Up and down" },
  drives: (axis: string, velocity: string) => `${axis} ${velocity}`,
  missing: (name: string) => `${name}, not on this one`,
  pressed: (number: number) => `button ${number + 1} is pressed`,
  armed: "enabled: the stick moves",
  held: "let the button go, centre the stick, and press again",
  loose: "hold the button, then move the stick",
  scale: (axis: string, velocity: string) => `Full deflection moves ${axis} at ${velocity}.`,
  hint: "One axis at a time. Use a cable: that a radio link is lost is known late.",
  again: "Let the button go, and press it again.",
  otherJog: "another button or key jogs",
  lost: (name: string) => `${name} is gone`,
  lostRemedy: "Its jog has ended. Connect it, and switch it on again.",
};

export const work = {
  busy: (words: string) => `Not while this is under way: ${words}`,
  busyRemedy: "Wait for its end, or stop it.",
  cancel: "Stop this",
  ended: (state: string) => `It ended: ${state}.`,
  socketClosed: "The connection to the gateway was lost: the work ends by itself.",
};

export const many = {
  title: "Controllers that are shown",
  filter: "Filter by name",
  before: "Controllers before these",
  after: "Controllers after these",
  noMore: "there are no more",
  range: (from: number, to: number, all: number, fleet: number) => `${from} to ${to} of ${all}${all === fleet ? "" : `, of ${fleet}`}`,
  count: (count: number, what: string) => `${count} ${what}`,
  choose: "Choose an axis in the table.",
  andMore: (names: string, count: number) => `${names} and ${count} more`,
};

export const prepare = {
  title: "Get ready",
  enabled: (count: number, all: number) => `${count} of ${all} motors on`,
  referenced: (count: number, all: number) => `${count} of ${all} axes referenced`,
  enableAll: "Enable all",
  disableAll: "Disable all",
  homeAll: "Home all, in the order of the fleet",
  enableShown: (count: number) => `Enable the ${count} shown`,
  disableShown: (count: number) => `Disable the ${count} shown`,
  homeShown: (count: number) => `Home the ${count} shown`,
  homing: (axes: string) => `homing: ${axes}`,
};

export const permits = { title: "Permits", none: "No permit is missing." };

export const io = {
  title: "Inputs and outputs",
  none: "No inputs and outputs have names in the fleet file.",
  input: "input",
  output: "output",
  active: "active",
  passive: "passive",
  on: "Switch on",
  off: "Switch off",
  switchOn: (name: string) => `Switch on ${name}`,
  switchOff: (name: string) => `Switch off ${name}`,
};

export const wiring = {
  title: "Wiring",
  check: "Check the wiring",
  hint: "Switches every wired output once, and reads all inputs.",
  running: "it is being checked",
  none: "No wire is described in the fleet file.",
};

export const positions = {
  title: "Named positions",
  none: "No position has a name yet.",
  ofFile: "in the fleet file",
  savedBy: (actor: string) => `saved by ${actor}`,
  go: "Go",
  goTo: (name: string) => `Go to ${name}`,
  removeOf: (name: string) => `Remove position ${name}`,
  save: "Save the present position",
  saveNow: "Save",
  name: "Name",
  nameRule: "give it a name of small letters, digits, - and _",
  description: "Description",
  axes: "Axes",
  allAxes: "all referenced",
};

export const cameras = {
  title: "Cameras",
  show: "Show",
  hide: "Hide",
  loading: (title: string) => `${title}: waiting for the picture …`,
  silent: (title: string) => `${title} does not answer`,
  silentRemedy: (host: string) => `Look whether ${host} is on and in the network, and whether this browser opens its address.`,
  late: "Nothing has come for 10 s.",
  unknown: (title: string) => `${title} was not known when this page was loaded`,
  unknownRemedy: "Load the page again: a browser asks the gateway only then where pictures may come from.",
  plain: (title: string) => `${title} has an address without TLS`,
  plainRemedy: "A page by https shows nothing of http. Give the camera TLS, or a proxy with it, and its https address in the fleet file.",
  again: "Try again",
  note: "A picture may be late or stand still: it is no sign that nothing moves.",
};

export const plots = {
  title: "Plots",
  add: "Add an axis",
  remove: (axis: string) => `Remove ${axis} from the plot`,
  name: (axes: string) => `Positions of ${axes} over the last minute`,
};

export const plane = {
  open: "XY",
  show: "XY view",
  title: "XY view",
  hide: "Hide the XY view",
  across: "Axis to the right",
  upwards: "Axis upwards",
  whole: "Limits",
  name: (x: string, y: string, atX: string, atY: string) => `${x} at ${atX}, ${y} at ${atY}`,
};

export const zones = {
  open: "Zones",
  title: "Zones",
  broken: "Zones: a rule is broken",
  hide: "Hide the zones",
  reset: "Reset view",
  name: (bodies: string) => `${bodies} in space; arrow keys turn the picture`,
  apart: (distance: number, least: number) => `${distance.toPrecision(3)} mm, at least ${least.toPrecision(3)}`,
  unknown: "not known: an axis may be anywhere",
  software: "Zones are software, no safety function.",
};

export const job = {
  title: "Running job",
  none: "No job is running.",
  name: (name: string) => `Job ${name}`,
  progress: (name: string) => `Progress of ${name}`,
  step: (step: number, steps: number) => `step ${step} of ${steps}`,
  point: (point: number, points: number) => `point ${point} of ${points}`,
  remaining: (time: string) => `${time} left`,
  stages: "Stage of each member",
  pause: "Pause after this step",
  pauseNow: "Pause now",
  go: "Go",
  override: "Speed on the path",
  overrideNow: (now: string) => `now ${now} of the planned speed`,
  overrideSet: "Set",
  resume: "Resume",
  cancel: "Cancel",
  verb: (verb: string, name: string) => `${verb.charAt(0).toUpperCase()}${verb.slice(1)} ${name}`,
  last: "Last motion step",
  lastJob: (job: string) => `Last: ${job}`,
  lastStep: (job: string, step: number, name: string) => `Last: ${job}, step ${step}${name ? ` ${name}` : ""}`,
};

export const verdict = { green: "green", amber: "amber", red: "red", none: "no verdict" };

export const budget = {
  what: "Skew",
  predicted: "Promised",
  allowed: "Allowed",
  measured: "Measured",
  start: "start",
  end: "end",
  path: "path",
  duration: "duration",
  terms: (member: string, term: string) => `Terms of the budget; the largest: ${member}, ${term}`,
};

export const strip = {
  caption: "Starts about T0: dark as measured, light as promised",
  line: (axis: string, from: string, to: string) => `${axis} started between ${from} and ${to} after T0`,
};

export const queue = {
  title: (count: number) => `Queue: ${count} waiting`,
  list: "Waiting jobs",
  none: "No job waits.",
  start: "Start queue",
  stop: "Stop queue",
  add: "New job",
  stopped: (reason: string, actor: string, utc: string) => `Stopped by ${actor} at ${utc} UTC: ${reason}`,
  journal: (mode: string) => `Journal: ${mode}`,
  next: "next",
  hold: "Hold",
  holdOf: (name: string) => `Hold ${name}`,
  release: "Release",
  releaseOf: (name: string) => `Release ${name}`,
  before: "Before …",
  beforeOf: (name: string) => `Move ${name} before`,
  last: "to the end",
  moveOf: (name: string) => `Move ${name} in the queue`,
  dragHint: "Drag to move",
  more: (count: number) => `and ${count} more`,
  proposed: "proposed",
  priority: (value: number) => `priority ${value}`,
  repeat: (value: number) => `${value} times`,
  at: (utc: string) => `not before ${utc} UTC`,
  after: (id: string) => `after ${id}`,
  expires: (utc: string) => `expires ${utc} UTC`,
  held: (by: string) => `held by ${by}`,
  fromStep: (step: number) => `from step ${step}`,
};

export const submit = {
  title: "New job",
  of: (name: string) => `Job ${name}`,
  drop: "Drop a job file or G-code anywhere on the page, or",
  dropHere: "Drop the job file",
  choose: "Choose a file",
  templates: "Templates",
  noTemplates: "There are no templates.",
  use: "Fill in",
  useOf: (name: string) => `Fill in ${name}`,
  tooLarge: "The file is larger than 1 MB.",
  tooLargeRemedy: "Split it into smaller jobs, or have it submitted on the computer of the fleet.",
  parameters: "Parameters",
  needed: "needed",
  problems: "Problems",
  line: (line: number) => `line ${line}:`,
  checking: "Checking …",
  notChecked: "it has not been checked yet",
  hasProblems: "mend what is listed above first",
  underWay: "it is being submitted",
  terms: "When it may begin",
  priority: "Priority",
  priorityNote: "-100 to 100; higher ones come first",
  repeat: "How often",
  at: "Not before",
  atNote: "in the time zone of this device",
  held: "Hold it until it is released",
  missed: "Run it even if its time was missed",
  submit: "Submit",
  propose: "Propose",
  submitted: (name: string) => `${name} is in the queue`,
  proposed: (name: string) => `${name} waits for the approval of an operator`,
};

export const program = {
  legend: "– – rapid, — feed, ○ begin",
  reach: "Reach of the program",
  limits: (limits: string) => `limits ${limits}`,
  over: (over: number, unit: string) => `▲ ${over} ${unit} too far`,
  text: "Program",
  startAt: (line: number) => `Start here: line ${line}`,
  goOn: "Go on",
  goOnWith: (name: string) => `Go on with ${name}`,
  going: "it goes on here when the axes are there; the queue says what the move waits for",
  unsure: "confirm what is written above first",
};

export const buttons = {
  title: "Buttons",
  withForm: (label: string) => `${label} …`,
  from: (file: string) => `submits ${file}`,
  broken: (problem: string) => `its job file has a mistake: ${problem}`,
  mend: (file: string) => `Mend ${file} on the computer of the fleet.`,
};

export const preview = {
  duration: (time: string) => `lasts ${time}`,
  overTime: "Each axis over time",
  path: (axes: string) => `Path of ${axes}`,
  pathAxis: (number: number) => `Axis ${number} of the path`,
  pathNote: "○ begin, □ end",
  step: "Step",
  what: "What it does",
  lasts: "Lasts",
  budget: "Start skew",
  within: (predicted: string, allowed: string) => `≤ ${predicted} of ${allowed}`,
};

export const path = {
  course: (length: string, time: string, frame: string) => `path of ${length}${frame ? ` in ${frame}` : ""} in ${time}`,
  bound: (predicted: string, allowed: string) => `at most ${predicted} off it; ${allowed} are allowed`,
  proven: (size: string) => `proven afterwards: at most ${size}`,
  terms: "Bound by member",
  member: "Member",
  plan: "the plan",
  term: { "profile-fit": "Profile fit", execution: "Execution", start: "Start", clock: "Clock" },
};

export const approval = {
  review: "Review",
  reviewOf: (name: string) => `Review ${name}`,
  title: (name: string) => `Approve ${name}`,
  of: (name: string) => `Approval of ${name}`,
  by: (actor: string) => `Proposed by ${actor}`,
  loading: "The plan is being made …",
  plan: "Plan",
  release: "Release exactly this plan",
  reject: "Reject",
  done: (name: string) => `${name} is released`,
  hint: "The plan is checked again now, and when its turn comes. If it differs then, the job is held again, with what has changed.",
};

export const alarms = {
  title: "Alarms",
  none: "No alarms.",
  count: (open: number) => (open === 0 ? "No alarms" : `${open} alarm${s(open)}`),
  fresh: (fresh: number) => `, ${fresh} new`,
  state: { unacknowledged: "new", acknowledged: "acknowledged", returned: "over, not acknowledged", normal: "over" },
  priority: (priority: string) => priority,
  times: (count: number) => `${count} times`,
  by: (actor: string) => `acknowledged by ${actor}`,
  acknowledge: "Acknowledge",
  acknowledgeOf: (subject: string) => `Acknowledge the alarm of ${subject}`,
  acknowledgeAll: (count: number) => `Acknowledge all ${count}`,
  shelve: "Shelve",
  shelveOf: (subject: string) => `Shelve the alarm of ${subject}`,
  unshelve: "Take back",
  howLong: "For how long",
  span: (seconds: number) => (seconds < 3600 ? `${seconds / 60} min` : `${seconds / 3600} h`),
  why: "Why",
  whyNeeded: "write why",
  shelvedUntil: (utc: string, actor: string, why: string) => `shelved until ${utc} UTC by ${actor}${why ? `: ${why}` : ""}`,
  showAside: (count: number) => `Show what is set aside (${count})`,
};

export const clocks = {
  title: "Clocks",
  bound: "Bound",
  age: "Age",
  rate: "Rate",
  residual: "Residual",
  classes: "Start classes",
  learned: "Learned",
  none: "no clock",
  crystal: (moves: number, bound: string) => `crystal by ${moves} move${s(moves)}, ± ${bound} ppm`,
  unusual: (count: number, by: string) => `${count} unusual start${s(count)}, bounds wider by ${by}`,
  inconsistent: "readings do not fit the model",
  noHistory: "The course over time appears after a minute.",
  plots: { bound: "bound and rate", offset: "offset and rate" },
  plotted: "What is plotted",
  curve: { bound_us: "bound", offset_us: "offset", rate_ppm: "rate" },
  plot: (name: string) => `Clock of ${name} over time`,
};

export const links = {
  title: "Links",
  state: "State",
  age: "Age",
  out: "Sent",
  in: "Received",
  errors: "Errors",
  trace: "Trace",
  traceOf: (name: string) => `Trace of ${name}`,
  noTrace: "Nothing was sent or received within the last minute.",
};

export const events = {
  title: "Events",
  kind: "Kind",
  anyController: "all controllers",
  anyKind: "all kinds",
  search: "Text or job",
  none: "No events.",
  more: (count: number) => `and ${count} older ones: narrow the filters`,
};

export const history = {
  title: "History",
  state: "State",
  anyState: "all states",
  name: "Name",
  none: "No job has ended yet.",
  of: (name: string) => `Report of ${name}`,
  export: "Export as CSV",
  retry: "Run again …",
  retryOf: (name: string) => `Run again: ${name}`,
  within: "within the budget",
  retryNow: "Run these steps now",
  fromStep: "from step",
  step: (step: number, name: string) => `Step ${step}: ${name}`,
  evidence: "Budget and starts",
  scan: (done: number, points: number) => `${done} of ${points} points`,
  verdicts: (count: number, verdict: string) => `${count} ${verdict}`,
  perPoint: (least: string, mean: string, most: string) => `${least}, ${mean} and ${most} a point (least, mean, most)`,
  worstStart: (skew: string) => `start skew at most ${skew}`,
  pointFinding: (point: number, verdict: string, text: string) => `point ${point}, ${verdict}: ${text}`,
  recording: "Planned against actual",
  noRecording: "This step has no recording.",
  planned: (axis: string) => `${axis} planned`,
  actual: (axis: string) => `${axis} actual`,
  plot: (axis: string) => `Planned and actual position of ${axis}`,
};

export const jobPlot = {
  open: "Plot",
  openOf: (name: string) => `Plot of ${name}`,
  title: (name: string) => `All steps of ${name}`,
  name: (axes: string, first: number, last: number) => `Planned and actual positions of ${axes}, steps ${first} to ${last}`,
  hint: "Lines are planned, dots are read from the controllers. Numbers are the steps, each at its T0; 0 s is the first of them.",
  leftOut: (count: number) => `Left out: the ${count} step${s(count)} before.`,
  steps: (count: number) => `${count} step${s(count)} with their times`,
  span: (from: string, to: string) => `${from} s … ${to} s`,
};

export const points = {
  show: "Points",
  showOf: (step: number) => `Points of step ${step}`,
  point: "Point",
  target: "Position",
  off: "Deviation",
  verdict: "Verdict",
  skew: "Start skew",
  none: "No point was recorded.",
  earlier: "Earlier points",
  later: "Later points",
  isFirst: "these are the first points",
  isLast: "these are the last points",
  range: (first: number, last: number, all: number) => `points ${first} to ${last} of ${all}`,
  plot: (axes: string) => `Deviation of ${axes} over the points`,
  plotted: (count: number) => `The plot has the first ${count} points.`,
  offAxis: (axis: string) => `${axis} off its position`,
  at: (point: number) => `point ${point}`,
};

export const configuration = {
  title: "Configuration",
  file: "Fleet file",
  running: "Running",
  state: "State",
  same: "same",
  differs: "differs",
  whole: "Whole configuration",
  other: "Load another fleet file",
  choose: "Choose a fleet file",
  chooseFirst: "choose a fleet file first",
  noChanges: "it changes nothing",
  check: "Check of the fleet file",
  reload: "Load it",
  reloaded: (name: string) => `${name} is loaded`,
  changesOf: (name: string) => `What ${name} changes`,
  path: "Field",
  from: "Now",
  to: "Then",
  tooLargeRemedy: "Have it loaded on the computer of the fleet.",
};

export const console = {
  title: "Console",
  controller: "Controller",
  command: "Command in its own language",
  send: "Send",
  sent: (controller: string) => `Command to ${controller}`,
  know: "I know: it is sent as it is. No limit is checked, also of a motion that it begins.",
  whyKnow: "confirm first that no limit is checked",
  empty: "write a command first",
  underWay: "the last command has not been answered yet",
  log: "Commands and replies",
  noReply: "(an empty reply)",
  hint: "Arrow keys bring earlier commands back. All axes of the controller are acquired meanwhile; it is logged.",
  stops: "Stop and E-stop work as always.",
};

export const recordings = { title: "Recordings", none: "There are no recordings." };
export const commands = { title: "Commands", show: "Show", again: "Show again", none: "No commands yet." };

