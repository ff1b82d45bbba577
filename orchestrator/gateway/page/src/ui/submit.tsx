/** A new job: from a template's form or a dropped file; checked, previewed, submitted. */

import type { JSX } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { signal } from "@preact/signals";
import { explain } from "../core/format.ts";
import { get, newKey, post } from "../core/http.ts";
import { view } from "../core/look.ts";
import type { Checked, Parameter, QueueTerms, Refusal, Template } from "../core/model.ts";
import { accept, showNote, showRefusal } from "../core/notices.ts";
import { firstOf, proposes, whyNot } from "../core/rights.ts";
import { onPage, placeOnPage } from "../texts.ts";
import * as T from "../texts.ts";
import { Act, closeDialog, Empty, Field, openDialog } from "./parts.tsx";
import { ForecastSteps, PreviewPlots } from "./preview.tsx";
import { ProgramParts, ProgramText } from "./program.tsx";

/** Larger job files are for the command line: `tutti submit`. */
const LARGEST_FILE = 1_000_000;
const CHECK_MS = 400;

type Source = { text: string } | { template: string } | { program?: { name: string; text: string }; continues?: string };

/** The texts of programs that were submitted here, by the names of their jobs. */
export const programTexts: Record<string, string[]> = {};

const PROGRAM = /\.(ngc|nc|gcode|tap)$/i;

/** The templates, and a place for a file. */
export function NewJob(): JSX.Element {
  const [templates, setTemplates] = useState<Template[] | null>(null);
  useEffect(() => {
    void get<{ templates: Template[] }>("templates").then((answer) => setTemplates(accept(T.submit.templates, answer)?.templates ?? []));
  }, []);
  return (
    <div>
      <div class="dropplace">
        <p>{T.submit.drop}</p>
        <label class="act file">
          {T.submit.choose}
          <FileInput onFile={(file) => void openFile(file)} />
        </label>
      </div>
      <h3>{T.submit.templates}</h3>
      {templates === null ? <Empty text={T.loading} /> : null}
      {templates?.length === 0 ? <Empty text={T.submit.noTemplates} /> : null}
      <ul class="cards">
        {templates?.map((template) => (
          <li class="card" key={template.file}>
            <div class="cardtext">
              <b>{template.name}</b>
              <p class="reason">{template.description || template.file}</p>
              {template.problem ? <p class="reason bad">{`▲ ${template.problem}`}</p> : null}
            </div>
            <Act label={T.submit.use} name={T.submit.useOf(template.name)} onAct={() => openForm(template)} />
          </li>
        ))}
      </ul>
    </div>
  );
}

/** A choice of a file: a job file or a program. The same one can be chosen again, after it was mended. */
function FileInput({ onFile }: { onFile: (file: File) => void }): JSX.Element {
  return (
    <input
      type="file"
      accept=".yaml,.yml,.json,.ngc,.nc,.gcode,.tap"
      onChange={(event) => {
        const file = event.currentTarget.files?.[0];
        if (file) onFile(file);
        event.currentTarget.value = "";
      }}
    />
  );
}

/** A job that was not done goes on where it stood. */
export function GoOn({ id, name }: { id: string; name: string }): JSX.Element {
  return <Act label={T.program.goOn} name={T.program.goOnWith(name)} kind="small" onAct={() => openSource(name, { continues: id })} />;
}

/** The form of a template, with its check and its drawing. */
export function openForm({ name, file, parameters }: Template): void {
  openSource(name, { template: file }, parameters);
}

function openSource(name: string, source: Source, parameters: Parameter[] = []): void {
  openDialog(T.submit.of(name), <JobForm key={newKey()} source={source} parameters={parameters} name={name} />, true);
}

/** Submit a checked job; whether it was taken. `key`: the same one is the same job. */
export async function submitJob(name: string, job: Checked["job"], terms: QueueTerms, key: string): Promise<boolean> {
  const answer = await post<{ job_id: string }>("submit", { job, client_key: key, terms }, key);
  return accept(T.submit.of(name), answer) !== null;
}

/** Read a job file or a program that was dropped or chosen. `continues`: the job of the program, which goes on. */
export async function openFile(file: File, continues?: string): Promise<void> {
  if (file.size > LARGEST_FILE) {
    showRefusal(file.name, { code: "too-large", text: T.submit.tooLarge, remedy: T.submit.tooLargeRemedy });
    return;
  }
  const text = await file.text();
  openSource(file.name, continues || PROGRAM.test(file.name) ? { program: { name: file.name, text }, ...(continues ? { continues } : {}) } : { text });
}

/** Whether a file is being dragged over the page. */
export const dropping = signal(false);

export function watchDrops(): void {
  let depth = 0;
  const withFile = (event: DragEvent): boolean => event.dataTransfer?.types.includes("Files") ?? false;
  window.addEventListener("dragenter", (event) => {
    if (!withFile(event)) return;
    depth += 1;
    dropping.value = true;
  });
  window.addEventListener("dragleave", () => {
    depth = Math.max(0, depth - 1);
    if (depth === 0) dropping.value = false;
  });
  window.addEventListener("dragover", (event) => {
    if (withFile(event)) event.preventDefault();
  });
  window.addEventListener("drop", (event) => {
    depth = 0;
    dropping.value = false;
    const file = event.dataTransfer?.files[0];
    if (!file) return;
    event.preventDefault();
    void openFile(file);
  });
}

export function JobForm({ source, parameters, name }: { source: Source; parameters: Parameter[]; name: string }): JSX.Element {
  const [values, setValues] = useState<Record<string, string>>({});
  const [checked, setChecked] = useState<Checked | null>(null);
  const [refused, setRefused] = useState<Refusal | null>(null);
  const [terms, setTerms] = useState<QueueTerms>({});
  const [busy, setBusy] = useState(false);
  const [sure, setSure] = useState("");
  const [waiting, setWaiting] = useState(0);
  const key = useRef(newKey());
  const round = useRef(0);
  const declared = parameters.length > 0 ? parameters : (checked?.parameters ?? []);
  useEffect(() => {
    const mine = (round.current += 1);
    const timer = setTimeout(
      () =>
        void post<Checked>("check-job", { ...source, values }).then((answer) => {
          if (mine !== round.current) return; // there are newer values
          setRefused("refused" in answer ? answer.refused : null);
          setChecked("ok" in answer ? answer.ok : null);
        }),
      checked === null && refused === null ? 0 : CHECK_MS,
    );
    return () => clearTimeout(timer);
  }, [values, waiting]);
  const program = checked?.program;
  const text = "program" in source ? source.program?.text : undefined;
  // Each confirmation is one of what is shown: the way to a line, then what runs from there.
  const toConfirm = program ? program.approach || program.confirm.join() : "";
  const away = program?.approach ? waiting : 0;
  useEffect(() => {
    if (!away) return;
    const timer = setTimeout(() => setWaiting(away + 1), 1000);
    return () => clearTimeout(timer);
  }, [away, checked]);
  const choose = (next: Record<string, string>): void => {
    setValues(next);
    setWaiting(0); // the move under way, if there is one, is no longer the one to wait for
  };
  const problems = checked?.problems ?? [];
  const why = firstOf(
    whyNot("submit"),
    problems.length > 0 || refused ? T.submit.hasProblems : "",
    checked?.job || program?.retry ? "" : T.submit.notChecked,
    busy ? T.submit.underWay : away ? T.program.going : "",
    sure === toConfirm ? "" : T.program.unsure,
  );
  const submit = async (): Promise<void> => {
    setBusy(true);
    const own = { ...terms, ...program?.terms };
    const done = program?.retry
      ? accept(T.submit.of(name), await post("retry", { ...program.retry, client_key: key.current, terms: own }, key.current))
      : await submitJob(name, checked?.job, own, key.current);
    setBusy(false);
    if (!done) return;
    if (text) programTexts[name] = text.split("\n");
    if (program?.approach) {
      key.current = newKey();
      setSure("");
      setValues(program.values);
      setWaiting(1);
      return;
    }
    closeDialog();
    if (proposes()) showNote(T.submit.proposed(name));
    else if (view.value !== "run") showNote(T.submit.submitted(name)); // there the queue shows it
  };
  return (
    <div class="jobform">
      {declared.length > 0 ? (
        <fieldset class="form">
          <legend>{T.submit.parameters}</legend>
          {declared.map((parameter) => (
            <ParameterField
              key={parameter.name}
              parameter={parameter}
              value={values[parameter.name]}
              onValue={(value) => {
                const next = { ...values, [parameter.name]: value };
                if (value === "") delete next[parameter.name];
                choose(next);
                setChecked(checked ? { ...checked, job: null } : null);
              }}
            />
          ))}
        </fieldset>
      ) : null}
      {refused ? <p class="reason bad">{`▲ ${explain(refused)}`}</p> : null}
      {refused?.code === "needs-file" && "continues" in source ? (
        <label class="act file">
          {T.submit.choose}
          <FileInput onFile={(file) => void openFile(file, source.continues)} />
        </label>
      ) : null}
      {problems.length > 0 ? (
        <ul class="problems" role="alert" aria-label={T.submit.problems}>
          {problems.map((problem) => (
            <li key={`${problem.place} ${problem.text}`}>
              {problem.line ? <span class="num">{T.submit.line(problem.line)} </span> : null}
              {problem.place ? <code>{placeOnPage(problem.place)}</code> : null} {onPage(problem.text)}
            </li>
          ))}
        </ul>
      ) : null}
      {checked === null && refused === null ? <Empty text={T.submit.checking} /> : null}
      {program ? <ProgramParts program={program} sure={sure === toConfirm} onSure={(on) => setSure(on ? toConfirm : "")} /> : null}
      {text ? <ProgramText text={text} onStart={(line) => choose({ ...values, "from line": String(line) })} /> : null}
      {checked?.preview && problems.length === 0 ? <PreviewPlots preview={checked.preview} drawn={Boolean(program?.drawing.start)} /> : null}
      {problems.length === 0 ? <ForecastSteps forecast={checked?.forecast} dryRun={checked?.dry_run} /> : null}
      <TermsForm terms={terms} onTerms={setTerms} />
      <div class="row finish">
        <Act label={program?.act ? program.act : proposes() ? T.submit.propose : T.submit.submit} kind="strong" motion why={why} onAct={() => void submit()} />
        {why ? <span class="hint">{why}</span> : null}
      </div>
    </div>
  );
}

/** A field for one parameter; what it allows is written beside it, and the gateway checks it. */
function ParameterField(props: { parameter: Parameter; value: string | undefined; onValue: (value: string) => void }): JSX.Element {
  const { parameter, value, onValue } = props;
  const preset = parameter.default === null || parameter.default === undefined ? "" : String(parameter.default);
  const choices = parameter.type === "boolean" ? ["true", "false"] : (parameter.choices ?? []);
  const note = [parameter.description, rangeOf(parameter), preset ? "" : T.submit.needed].filter(Boolean).join(" · ");
  return (
    <Field label={`${parameter.name}${parameter.unit ? ` (${parameter.unit})` : ""}`} note={note}>
      {choices.length > 0 ? (
        <select value={value ?? preset} onChange={(event) => onValue(event.currentTarget.value)}>
          {preset ? null : <option value="">–</option>}
          {choices.map((choice) => (
            <option key={choice}>{choice}</option>
          ))}
        </select>
      ) : (
        <input type="text" value={value ?? ""} placeholder={preset} onInput={(event) => onValue(event.currentTarget.value)} />
      )}
    </Field>
  );
}

function rangeOf({ min, max }: Parameter): string {
  const has = (value: unknown): boolean => value !== null && value !== undefined;
  if (has(min) && has(max)) return `${String(min)} … ${String(max)}`;
  if (has(min)) return `≥ ${String(min)}`;
  return has(max) ? `≤ ${String(max)}` : "";
}

function TermsForm({ terms, onTerms }: { terms: QueueTerms; onTerms: (terms: QueueTerms) => void }): JSX.Element {
  const set = (change: QueueTerms): void => onTerms({ ...terms, ...change });
  const number = (text: string, least: number, most: number, first: number): number => {
    const value = Math.round(Number(text));
    return Number.isFinite(value) && text !== "" ? Math.max(least, Math.min(most, value)) : first;
  };
  return (
    <fieldset class="form">
      <legend>{T.submit.terms}</legend>
      <Field label={T.submit.priority} note={T.submit.priorityNote}>
        <input type="number" min={-100} max={100} value={terms.priority ?? 0} onInput={(event) => set({ priority: number(event.currentTarget.value, -100, 100, 0) })} />
      </Field>
      <Field label={T.submit.repeat}>
        <input type="number" min={1} max={10000} value={terms.repeat ?? 1} onInput={(event) => set({ repeat: number(event.currentTarget.value, 1, 10000, 1) })} />
      </Field>
      <Field label={T.submit.at} note={T.submit.atNote}>
        <input
          type="datetime-local"
          onInput={(event) => {
            const instant = new Date(event.currentTarget.value);
            set({ at: Number.isNaN(instant.getTime()) ? null : instant.toISOString() });
          }}
        />
      </Field>
      <label class="check">
        <input type="checkbox" checked={terms.held ?? false} onChange={(event) => set({ held: event.currentTarget.checked })} />
        {T.submit.held}
      </label>
      {terms.at ? (
        <label class="check">
          <input type="checkbox" checked={terms.missed === "run"} onChange={(event) => set({ missed: event.currentTarget.checked ? "run" : "skip" })} />
          {T.submit.missed}
        </label>
      ) : null}
    </fieldset>
  );
}
