/** Inputs and outputs, and the check of the wires between them. */

import type { JSX } from "preact";
import { signal } from "@preact/signals";
import { post } from "../core/http.ts";
import { beginWork, working } from "../core/manual.ts";
import type { WireFinding } from "../core/model.ts";
import { accept } from "../core/notices.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import { controllers, type ControllerStore } from "../core/store.ts";
import { pageAge } from "../core/stream.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { Act, Empty, Mark, Panel } from "./parts.tsx";

const wires = signal<WireFinding[] | null>(null);
const checking = signal(false);

export function IoPanel(): JSX.Element {
  const some = controllers.value.filter(hasPoints);
  return (
    <Panel title={T.io.title} area="io">
      {some.length === 0 ? <Empty text={T.io.none} /> : null}
      {some.map((controller) => (
        <Points key={controller.id} controller={controller} />
      ))}
      <h3>{T.wiring.title}</h3>
      <div class="row">
        <Act label={T.wiring.check} why={firstOf(whyNot("check-wiring"), checking.value ? T.wiring.running : "")} motion onAct={() => void checkWiring()} />
        <span class="hint">{T.wiring.hint}</span>
      </div>
      {wires.value?.length === 0 ? <Empty text={T.wiring.none} /> : null}
      <ul class="plain">
        {wires.value?.map((wire) => (
          <li key={`${wire.output} ${wire.input}`}>
            <Mark level={wire.ok ? "ok" : "bad"} text={`${wire.output} → ${wire.input}`} /> {onPage(wire.text)}
            {wire.remedy ? <small class="remedy">{onPage(wire.remedy)}</small> : null}
          </li>
        ))}
      </ul>
    </Panel>
  );
}

function hasPoints(controller: ControllerStore): boolean {
  const { inputs, outputs } = controller.rest.value;
  return Object.keys({ ...inputs, ...outputs }).length > 0;
}

function Points({ controller }: { controller: ControllerStore }): JSX.Element {
  const { inputs = {}, outputs = {} } = controller.rest.value;
  const stale = Math.max(controller.age.value, pageAge.value) >= 1;
  const why = firstOf(whyNot("work", controller.id), working.value ? T.why.working(working.value.words) : "");
  return (
    <table class={`points ${stale ? "stale" : ""}`}>
      <tbody>
        {Object.entries(inputs).map(([name, on]) => (
          <tr key={`in ${name}`}>
            <th scope="row">{`${controller.id}.${name}`}</th>
            <td>{T.io.input}</td>
            <td>
              <PointState on={on} />
            </td>
            <td />
          </tr>
        ))}
        {Object.entries(outputs).map(([name, on]) => {
          const id = `${controller.id}.${name}`;
          const words = on ? T.io.switchOff(id) : T.io.switchOn(id);
          return (
            <tr key={`out ${name}`}>
              <th scope="row">{id}</th>
              <td>{T.io.output}</td>
              <td>
                <PointState on={on} />
              </td>
              <td>
                <Act label={on ? T.io.off : T.io.on} name={words} kind="small" why={why} motion onAct={() => void beginWork(words, [], { do: "output", output: id, value: !on })} />
              </td>
            </tr>
          );
        })}
      </tbody>
    </table>
  );
}

function PointState({ on }: { on: boolean }): JSX.Element {
  return (
    <span class={`point ${on ? "on" : ""}`}>
      <span aria-hidden="true">{on ? "●" : "○"}</span> {on ? T.io.active : T.io.passive}
    </span>
  );
}

async function checkWiring(): Promise<void> {
  checking.value = true;
  const done = accept(T.wiring.check, await post<{ wires?: WireFinding[] }>("check-wiring"));
  checking.value = false;
  if (done) wires.value = done.wires ?? [];
}
