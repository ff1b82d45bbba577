/** Events with filters. */

import type { JSX } from "preact";
import { useState } from "preact/hooks";
import { eventLog } from "../core/eventlog.ts";
import { dayAndTime, shortId } from "../core/format.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { Empty, Panel } from "./parts.tsx";

const MOST_ROWS = 200;

export function EventsPanel(): JSX.Element {
  const [controller, setController] = useState("");
  const [kind, setKind] = useState("");
  const [text, setText] = useState("");
  const all = eventLog.value;
  const words = text.toLowerCase();
  const shown = all.filter(
    (event) =>
      (controller === "" || event.controller === controller) &&
      (kind === "" || event.kind === kind) &&
      (words === "" || `${event.text} ${event.job ?? ""}`.toLowerCase().includes(words)),
  );
  const choices = (values: string[]): string[] => [...new Set(values)].sort();
  return (
    <Panel
      title={T.events.title}
      area="events"
      scrolls
      tools={
        <div class="chips">
          <Filter label={T.controller} any={T.events.anyController} value={controller} choices={choices(all.map((event) => event.controller))} onChange={setController} />
          <Filter label={T.events.kind} any={T.events.anyKind} value={kind} choices={choices(all.map((event) => event.kind))} onChange={setKind} />
          <input type="search" aria-label={T.events.search} placeholder={T.events.search} value={text} onInput={(event) => setText(event.currentTarget.value)} />
        </div>
      }
    >
      {shown.length === 0 ? <Empty text={T.events.none} /> : null}
      <table class="eventtable">
        <tbody>
          {shown.slice(0, MOST_ROWS).map((event) => (
            <tr key={event.n}>
              <td class="num when">{dayAndTime(event.utc)}</td>
              <td>{event.controller}</td>
              <td>{event.kind}</td>
              <td>{onPage(event.text)}</td>
              <td class="quiet">{event.job ? shortId(event.job) : ""}</td>
            </tr>
          ))}
        </tbody>
      </table>
      {shown.length > MOST_ROWS ? <p class="hint">{T.events.more(shown.length - MOST_ROWS)}</p> : null}
    </Panel>
  );
}

function Filter(props: { label: string; any: string; value: string; choices: string[]; onChange: (value: string) => void }): JSX.Element {
  return (
    <select aria-label={props.label} value={props.value} onChange={(event) => props.onChange(event.currentTarget.value)}>
      <option value="">{props.any}</option>
      {props.choices.map((choice) => (
        <option key={choice}>{choice}</option>
      ))}
    </select>
  );
}
