/** Named positions: go there, save the present one, remove a saved one. */

import type { JSX } from "preact";
import { signal } from "@preact/signals";
import { useEffect, useState } from "preact/hooks";
import { get, post } from "../core/http.ts";
import { whyBeyondOf } from "../core/limits.ts";
import { beginWork, working } from "../core/manual.ts";
import type { NamedPosition } from "../core/model.ts";
import { accept } from "../core/notices.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import { controllers } from "../core/store.ts";
import { connection } from "../core/stream.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { Act, Empty, Field, Panel } from "./parts.tsx";

const positions = signal<NamedPosition[] | null>(null);

async function load(): Promise<void> {
  const answer = await get<{ positions?: NamedPosition[] }>("positions");
  if ("ok" in answer) positions.value = answer.ok.positions ?? [];
}

export function PositionsPanel(): JSX.Element {
  const open = connection.value === "open";
  useEffect(() => {
    if (open) void load();
  }, [open]);
  const list = positions.value;
  return (
    <Panel title={T.positions.title} area="positions">
      {list === null ? <Empty text={T.loading} /> : list.length === 0 ? <Empty text={T.positions.none} /> : null}
      <ul class="cards">
        {list?.map((position) => (
          <PositionCard key={position.name} position={position} />
        ))}
      </ul>
      <SaveForm />
    </Panel>
  );
}

function PositionCard({ position }: { position: NamedPosition }): JSX.Element {
  const problems = [...(position.problems ?? []).map(onPage), ...whyBeyondOf(position.axes)];
  const why = firstOf(whyNot("work"), working.value ? T.why.working(working.value.words) : "", problems[0] ?? "");
  const remove = async (): Promise<void> => {
    if (accept(T.positions.removeOf(position.name), await post("remove-position", { name: position.name })) !== null) await load();
  };
  return (
    <li class="card">
      <div class="cardtext">
        <b>{position.name}</b> <span class="quiet">{position.source === "file" ? T.positions.ofFile : T.positions.savedBy(position.actor ?? "")}</span>
        {position.description ? <p class="reason">{position.description}</p> : null}
        <p class="facts num">
          {Object.entries(position.axes).map(([axis, value]) => (
            <span key={axis}>{`${axis} ${String(value)}`}</span>
          ))}
        </p>
        {problems.map((text) => (
          <p class="reason bad" key={text}>{`▲ ${text}`}</p>
        ))}
      </div>
      <div class="cardtools">
        <Act
          label={T.positions.go}
          name={T.positions.goTo(position.name)}
          kind="small"
          motion
          why={why}
          onAct={() => void beginWork(T.positions.goTo(position.name), Object.keys(position.axes), { do: "move", to: position.name, speed: "manual" })}
        />
        {position.source === "file" ? null : (
          <Act label="✕" name={T.positions.removeOf(position.name)} kind="small" why={whyNot("remove-position")} onAct={() => void remove()} />
        )}
      </div>
    </li>
  );
}

function SaveForm(): JSX.Element {
  const [name, setName] = useState("");
  const [description, setDescription] = useState("");
  const [from, setFrom] = useState("");
  const why = firstOf(whyNot("save-position"), /^[a-z][a-z0-9_-]*$/.test(name) ? "" : T.positions.nameRule);
  const save = async (): Promise<void> => {
    const body = { name, axes: from ? [from] : [], values: {}, description: description || null };
    if (accept(T.positions.save, await post("save-position", body)) === null) return;
    setName("");
    setDescription("");
    await load();
  };
  return (
    <fieldset class="form">
      <legend>{T.positions.save}</legend>
      <Field label={T.positions.name}>
        <input type="text" value={name} maxLength={40} onInput={(event) => setName(event.currentTarget.value.trim())} />
      </Field>
      <Field label={T.positions.description}>
        <input type="text" value={description} maxLength={200} onInput={(event) => setDescription(event.currentTarget.value)} />
      </Field>
      <Field label={T.positions.axes}>
        <select value={from} onChange={(event) => setFrom(event.currentTarget.value)}>
          <option value="">{T.positions.allAxes}</option>
          {controllers.value.flatMap((controller) => [
            <option key={controller.id} value={controller.id}>
              {controller.id}
            </option>,
            ...controller.axes.value.map((axis) => (
              <option key={axis.id} value={axis.id}>
                {axis.id}
              </option>
            )),
          ])}
        </select>
      </Field>
      <Act label={T.positions.saveNow} why={why} onAct={() => void save()} />
    </fieldset>
  );
}
