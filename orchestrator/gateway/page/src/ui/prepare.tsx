/** What a machine needs before it runs: motors on, references found, permits there. */

import type { JSX } from "preact";
import { isMany, shown } from "../core/many.ts";
import { beginWork, working } from "../core/manual.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import { realAxes, controllers, jobs, permits } from "../core/store.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { GetReady, unready } from "./getready.tsx";
import { WorkLine } from "./jogpad.tsx";
import { Act, Empty, Mark, Panel } from "./parts.tsx";

export function PreparePanel(): JSX.Element {
  const axes = realAxes().filter((axis) => !isMany.value || shown.value.includes(axis.controller));
  const count = (test: (axis: (typeof axes)[number]) => boolean): number => axes.filter(test).length;
  const enabled = count((axis) => axis.flags.value.enabled);
  const referenced = count((axis) => axis.flags.value.referenced);
  const homing = axes.filter((axis) => axis.flags.value.homing).map((axis) => axis.id);
  const why = firstOf(whyNot("work"), working.value ? T.why.working(working.value.words) : "");
  const some = isMany.value;
  const all = controllers.value.map((controller) => controller.id).filter((id) => !some || shown.value.includes(id));
  const words = some
    ? { enable: T.prepare.enableShown(all.length), disable: T.prepare.disableShown(all.length), home: T.prepare.homeShown(all.length) }
    : { enable: T.prepare.enableAll, disable: T.prepare.disableAll, home: T.prepare.homeAll };
  const ids = axes.map((axis) => axis.id);
  const work = (title: string, step: object): void => void beginWork(title, ids, step);
  const job = Object.values(jobs.value).find((each) => each.state === "running");
  return (
    <Panel title={T.prepare.title} area="prepare" tools={unready.value.length > 0 ? <GetReady ids={[]} /> : null}>
      <div class="row">
        <Mark level={enabled === axes.length ? "ok" : "off"} text={T.prepare.enabled(enabled, axes.length)} />
        <Act label={words.enable} why={why} motion onAct={() => work(words.enable, { do: "enable", axes: all })} />
        <Act label={words.disable} why={why} onAct={() => work(words.disable, { do: "disable", axes: all })} />
      </div>
      <div class="row">
        <Mark level={referenced === axes.length ? "ok" : "off"} text={T.prepare.referenced(referenced, axes.length)} />
        <Act label={words.home} why={why} motion onAct={() => work(words.home, { do: "home", ...(some && { axes: all }) })} />
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
