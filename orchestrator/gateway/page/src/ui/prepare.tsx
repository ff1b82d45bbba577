/** What a machine needs before it runs: motors on, references found, permits there. */

import type { JSX } from "preact";
import { beginWork, working } from "../core/manual.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import { realAxes, controllers, jobs, permits } from "../core/store.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { GetReady, unready } from "./getready.tsx";
import { WorkLine } from "./jogpad.tsx";
import { Act, Empty, Mark, Panel } from "./parts.tsx";

export function PreparePanel(): JSX.Element {
  const axes = realAxes();
  const count = (test: (axis: (typeof axes)[number]) => boolean): number => axes.filter(test).length;
  const enabled = count((axis) => axis.flags.value.enabled);
  const referenced = count((axis) => axis.flags.value.referenced);
  const homing = axes.filter((axis) => axis.flags.value.homing).map((axis) => axis.id);
  const why = firstOf(whyNot("work"), working.value ? T.why.working(working.value.words) : "");
  const all = controllers.value.map((controller) => controller.id);
  const ids = axes.map((axis) => axis.id);
  const work = (words: string, step: object): void => void beginWork(words, ids, step);
  const job = Object.values(jobs.value).find((each) => each.state === "running");
  return (
    <Panel title={T.prepare.title} area="prepare" tools={unready.value.length > 0 ? <GetReady ids={[]} /> : null}>
      <div class="row">
        <Mark level={enabled === axes.length ? "ok" : "off"} text={T.prepare.enabled(enabled, axes.length)} />
        <Act label={T.prepare.enableAll} why={why} motion onAct={() => work(T.prepare.enableAll, { do: "enable", axes: all })} />
        <Act label={T.prepare.disableAll} why={why} onAct={() => work(T.prepare.disableAll, { do: "disable", axes: all })} />
      </div>
      <div class="row">
        <Mark level={referenced === axes.length ? "ok" : "off"} text={T.prepare.referenced(referenced, axes.length)} />
        <Act label={T.prepare.homeAll} why={why} motion onAct={() => work(T.prepare.homeAll, { do: "home" })} />
        {homing.length > 0 ? <span class="hint">{T.prepare.homing(homing.join(", "))}</span> : null}
      </div>
      {working.value && job ? <p class="hint">{job.step_name || onPage(job.reason)}</p> : null}
      <WorkLine />
      <h3>{T.permits.title}</h3>
      {permits.value.length === 0 ? <Empty text={T.permits.none} /> : null}
      <ul class="plain">
        {permits.value.map((permit) => (
          <li key={permit.name}>
            <Mark level="bad" text={permit.name} /> {onPage(permit.text)} <span class="quiet">{permit.axes.join(", ")}</span>
          </li>
        ))}
      </ul>
    </Panel>
  );
}
