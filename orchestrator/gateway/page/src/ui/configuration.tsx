/** The configuration with its digests, and loading another fleet file after a look at what it changes. */

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { dayAndTime } from "../core/format.ts";
import { get, post } from "../core/http.ts";
import { accept, showNote } from "../core/notices.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { Act, Empty, Mark, Panel } from "./parts.tsx";
import { usePolled } from "./polled.ts";

interface FleetShown {
  configuration: unknown;
  digests: Record<string, { file?: string | null; running?: string | null }>;
}

interface FleetChecked {
  problems?: { line?: number | null; place?: string; text: string }[];
  changes?: { path: string; from: unknown; to: unknown }[];
  configuration?: Record<string, unknown> | null;
}

const REFRESH_MS = 10_000;

export function ConfigurationPanel(): JSX.Element {
  const shown = usePolled<FleetShown>("fleet", REFRESH_MS);
  return (
    <Panel title={T.configuration.title} area="configuration">
      {shown === null ? <Empty text={T.loading} /> : null}
      <table>
        <thead>
          <tr>
            <th scope="col">{T.controller}</th>
            <th scope="col">{T.configuration.file}</th>
            <th scope="col">{T.configuration.running}</th>
            <th scope="col">{T.configuration.state}</th>
          </tr>
        </thead>
        <tbody>
          {Object.entries(shown?.digests ?? {}).map(([controller, digest]) => {
            const same = Boolean(digest.file) && digest.file === digest.running;
            return (
              <tr key={controller}>
                <th scope="row">{controller}</th>
                <td>
                  <code>{shortDigest(digest.file)}</code>
                </td>
                <td>
                  <code>{shortDigest(digest.running)}</code>
                </td>
                <td>
                  <Mark level={same ? "ok" : "bad"} text={same ? T.configuration.same : T.configuration.differs} />
                </td>
              </tr>
            );
          })}
        </tbody>
      </table>
      {shown ? (
        <details>
          <summary>{T.configuration.whole}</summary>
          <pre tabIndex={0}>{JSON.stringify(shown.configuration, null, 2)}</pre>
        </details>
      ) : null}
      <Reload />
    </Panel>
  );
}

function shortDigest(digest: string | null | undefined): string {
  return digest ? digest.replace("sha256:", "").slice(0, 12) : "–";
}

const LARGEST_FILE = 1_000_000;

function Reload(): JSX.Element {
  const [checked, setChecked] = useState<FleetChecked | null>(null);
  const [name, setName] = useState("");
  const problems = checked?.problems ?? [];
  const changes = checked?.changes ?? [];
  const why = firstOf(
    whyNot("reload"),
    checked?.configuration ? "" : T.configuration.chooseFirst,
    problems.length > 0 ? T.submit.hasProblems : "",
    changes.length === 0 ? T.configuration.noChanges : "",
  );
  const read = async (file: File): Promise<void> => {
    setName(file.name);
    if (file.size > LARGEST_FILE) return showNote(T.submit.tooLarge, T.configuration.tooLargeRemedy);
    setChecked(accept(T.configuration.check, await post<FleetChecked>("check-fleet", { text: await file.text() })));
  };
  const reload = async (): Promise<void> => {
    const done = accept(T.configuration.reload, await post<{ changed?: string[] }>("reload", { configuration: checked?.configuration }));
    if (done === null) return;
    setChecked(null);
    showNote(T.configuration.reloaded(name), (done.changed ?? []).join(", "));
  };
  return (
    <fieldset class="form block">
      <legend>{T.configuration.other}</legend>
      <label class="act file">
        {T.configuration.choose}
        <input
          type="file"
          accept=".yaml,.yml"
          onChange={(event) => {
            const file = event.currentTarget.files?.[0];
            event.currentTarget.value = "";
            if (file) void read(file);
          }}
        />
      </label>
      {problems.map((problem) => (
        <p class="reason bad" key={`${problem.place} ${problem.text}`}>
          {`▲ ${problem.line ? `${T.submit.line(problem.line)} ` : ""}${problem.place ?? ""} ${onPage(problem.text)}`}
        </p>
      ))}
      {checked && problems.length === 0 ? <Changes changes={changes} name={name} /> : null}
      <Act label={T.configuration.reload} why={why} onAct={() => void reload()} />
    </fieldset>
  );
}

function Changes({ changes, name }: { changes: NonNullable<FleetChecked["changes"]>; name: string }): JSX.Element {
  if (changes.length === 0) return <Empty text={T.configuration.noChanges} />;
  const words = (value: unknown): string => (value === null || value === undefined ? "–" : typeof value === "string" ? value : JSON.stringify(value));
  return (
    <table class="changes" aria-label={T.configuration.changesOf(name)}>
      <thead>
        <tr>
          <th scope="col">{T.configuration.path}</th>
          <th scope="col">{T.configuration.from}</th>
          <th scope="col">{T.configuration.to}</th>
        </tr>
      </thead>
      <tbody>
        {changes.map((change) => (
          <tr key={change.path}>
            <th scope="row">
              <code>{change.path}</code>
            </th>
            <td class="was">− {words(change.from)}</td>
            <td class="becomes">+ {words(change.to)}</td>
          </tr>
        ))}
      </tbody>
    </table>
  );
}

/** Ask for a file of the gateway by name: which recordings there are. */
export function RecordingsPanel(): JSX.Element {
  const shown = usePolled<{ files?: { name: string; bytes: number; changed_utc?: string; begin_utc?: string }[] }>("recordings", REFRESH_MS);
  const files = shown?.files ?? [];
  return (
    <Panel title={T.recordings.title} area="recordings" scrolls>
      {files.length === 0 ? <Empty text={T.recordings.none} /> : null}
      <table class="num files">
        <tbody>
          {files.map((file) => (
            <tr key={file.name}>
              <th scope="row">{file.name}</th>
              <td>{`${(file.bytes / 1e6).toFixed(1)} MB`}</td>
              <td class="when">{dayAndTime(file.changed_utc ?? file.begin_utc)}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </Panel>
  );
}

interface CommandShown {
  utc: string;
  actor: string;
  verb: string;
  subject?: string;
  refused?: string | { text: string } | null;
}

/** Every command, with its user and address. */
export function CommandsPanel(): JSX.Element {
  const [commands, setCommands] = useState<CommandShown[] | null>(null);
  const load = async (): Promise<void> => setCommands(accept(T.commands.title, await get<{ commands?: CommandShown[] }>("commands?limit=100"))?.commands ?? null);
  return (
    <Panel title={T.commands.title} area="commands" scrolls tools={<Act label={commands === null ? T.commands.show : T.commands.again} kind="small" onAct={() => void load()} />}>
      {commands?.length === 0 ? <Empty text={T.commands.none} /> : null}
      <table>
        <tbody>
          {commands?.map((command, index) => (
            <tr key={index}>
              <td class="num when">{dayAndTime(command.utc)}</td>
              <td>{command.actor}</td>
              <td>{command.verb}</td>
              <td>{command.subject}</td>
              <td class="quiet">{typeof command.refused === "object" ? command.refused?.text : command.refused}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </Panel>
  );
}
