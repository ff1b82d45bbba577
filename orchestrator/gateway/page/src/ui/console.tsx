/** `tutti raw` on the page: a command in a controller's own language, with what goes over its link beside it. */

import type { JSX } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { signal } from "@preact/signals";
import { explain } from "../core/format.ts";
import { post } from "../core/http.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import { controllers } from "../core/store.ts";
import * as T from "../texts.ts";
import { Act, Empty, Field, Panel } from "./parts.tsx";
import { Trace } from "./links.tsx";

const MOST_LINES = 100;
const LONGEST = 4000;

interface Line {
  key: number;
  controller: string;
  command: string;
  reply: string;
  bad: boolean;
}

/** As long as the page is open, and not longer: nothing of it is kept in the browser. */
const lines = signal<Line[]>([]);
/** Commands that were sent, the newest last. */
const sent = signal<string[]>([]);
let lastKey = 0;

export function ConsolePanel(): JSX.Element {
  const why = whyNot("raw");
  return (
    <Panel title={T.console.title} area="console">
      {why && controllers.value.length > 0 ? <p class="reason">{why}</p> : null}
      {controllers.value.length === 0 ? <Empty text={T.axes.none} /> : why ? null : <Console />}
    </Panel>
  );
}

function Console(): JSX.Element {
  const ids = controllers.value.map((controller) => controller.id);
  const [chosen, setChosen] = useState("");
  const controller = ids.includes(chosen) ? chosen : (ids[0] ?? "");
  const [command, setCommand] = useState("");
  const [knows, setKnows] = useState(false);
  const [busy, setBusy] = useState(false);
  /** How many commands back; 0: what is being written. */
  const back = useRef(0);
  const written = useRef("");
  const why = firstOf(whyNot("raw"), command.trim() ? "" : T.console.empty, knows ? "" : T.console.whyKnow, busy ? T.console.underWay : "");

  const send = async (): Promise<void> => {
    setBusy(true);
    sent.value = [...sent.value.filter((earlier) => earlier !== command), command].slice(-MOST_LINES);
    back.current = 0;
    setCommand("");
    const answer = await post<{ reply?: string }>(`controllers/${encodeURIComponent(controller)}/raw`, { command, i_know: true });
    setBusy(false);
    lastKey += 1;
    const bad = "refused" in answer;
    const line = { key: lastKey, controller, command, reply: bad ? explain(answer.refused) : (answer.ok.reply ?? ""), bad };
    lines.value = [...lines.value, line].slice(-MOST_LINES);
  };
  const recall = (by: number): void => {
    const next = Math.max(0, Math.min(sent.value.length, back.current + by));
    if (next === back.current) return;
    if (back.current === 0) written.current = command;
    back.current = next;
    setCommand(next === 0 ? written.current : (sent.value.at(-next) ?? ""));
  };
  const onKeyDown = (event: KeyboardEvent): void => {
    if (event.key === "ArrowUp" || event.key === "ArrowDown") {
      event.preventDefault();
      recall(event.key === "ArrowUp" ? 1 : -1);
    } else if (event.key === "Enter" && !event.repeat && !event.isComposing && why === "") void send();
  };
  return (
    <>
      <Log />
      <Field label={T.console.controller}>
        <select
          value={controller}
          onChange={(event) => {
            setChosen(event.currentTarget.value);
            setKnows(false); // what is known of one controller says nothing about another
          }}
        >
          {ids.map((id) => (
            <option key={id}>{id}</option>
          ))}
        </select>
      </Field>
      <div class="row">
        <input
          class="commandline"
          type="text"
          aria-label={T.console.command}
          placeholder={T.console.command}
          value={command}
          maxLength={LONGEST}
          autocomplete="off"
          autocapitalize="off"
          spellcheck={false}
          onInput={(event) => setCommand(event.currentTarget.value)}
          onKeyDown={onKeyDown}
        />
        <Act label={T.console.send} motion why={why} onAct={() => void send()} />
      </div>
      <label class="check">
        <input type="checkbox" checked={knows} onChange={(event) => setKnows(event.currentTarget.checked)} />
        {T.console.know}
      </label>
      <p class="hint">{`${T.console.hint} ${T.console.stops}`}</p>
      <h3>{T.links.traceOf(controller)}</h3>
      <Trace key={controller} controller={controller} beside />
    </>
  );
}

/** What was sent and answered, the newest last, where it is written. */
function Log(): JSX.Element | null {
  const box = useRef<HTMLDivElement>(null);
  const all = lines.value;
  useEffect(() => {
    if (box.current) box.current.scrollTop = box.current.scrollHeight;
  }, [all]);
  if (all.length === 0) return null;
  return (
    <div class="scroll consolelog" role="log" aria-label={T.console.log} tabIndex={0} ref={box}>
      {all.map(({ key, controller, command, reply, bad }) => (
        <div key={key}>
          <p>
            <span class="quiet">{controller}</span> <code>{command}</code>
          </p>
          <p class={bad ? "reason bad" : ""}>{bad ? `▲ ${reply}` : <code>{reply || T.console.noReply}</code>}</p>
        </div>
      ))}
    </div>
  );
}
