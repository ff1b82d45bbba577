/** Job files that the fleet offers as buttons: one press submits the job, or opens the form of its parameters. */

import type { JSX } from "preact";
import { signal } from "@preact/signals";
import { newKey, post } from "../core/http.ts";
import type { Checked, Template } from "../core/model.ts";
import { accept, showNote, showRefusal } from "../core/notices.ts";
import { firstOf, proposes, whyNot } from "../core/rights.ts";
import { placeOnPage } from "../texts.ts";
import * as T from "../texts.ts";
import { Act, Panel } from "./parts.tsx";
import { usePolled } from "./polled.ts";
import { openForm, submitJob } from "./submit.tsx";

/** A file that is changed beside the fleet file appears within this time. */
const REFRESH_MS = 60_000;

/** The file whose job is being submitted: a second press would make a second job. */
const pressedFile = signal("");

/** Nothing at all while no job file has a button. */
export function ButtonsPanel(): JSX.Element | null {
  const offered = (usePolled<{ templates: Template[] }>("templates", REFRESH_MS)?.templates ?? []).filter((template) => template.button);
  if (offered.length === 0) return null;
  const groups = new Map<string, Template[]>();
  for (const template of offered) {
    const name = template.button?.group ?? "";
    groups.set(name, [...(groups.get(name) ?? []), template]);
  }
  // Those without a group come first, under no name.
  const ordered = [...groups].sort(([one], [other]) => one.localeCompare(other));
  return (
    <Panel title={T.buttons.title} area="buttons">
      {ordered.map(([group, templates]) => (
        <div class="row" role="group" aria-label={group || T.buttons.title} key={group}>
          {group ? <span class="quiet groupname">{group}</span> : null}
          {templates.map((template) => (
            <JobButton key={template.file} template={template} />
          ))}
        </div>
      ))}
    </Panel>
  );
}

function JobButton({ template }: { template: Template }): JSX.Element {
  const label = template.button?.label ?? template.name;
  const hasForm = template.parameters.length > 0;
  const why = firstOf(
    whyNot("submit"),
    template.problem ? T.buttons.broken(template.problem) : "",
    pressedFile.value === template.file ? T.submit.underWay : "",
  );
  return (
    <Act
      label={hasForm ? T.buttons.withForm(label) : label}
      title={T.buttons.from(template.file)}
      why={why}
      motion
      onAct={() => (hasForm ? openForm(template) : void submitAtOnce(template, label))}
    />
  );
}

/** Check the file as it is now, and submit its job. */
async function submitAtOnce(template: Template, label: string): Promise<void> {
  pressedFile.value = template.file;
  try {
    const checked = accept(label, await post<Checked>("check-job", { template: template.file, values: {} }));
    if (checked === null) return;
    const [problem] = checked.problems ?? [];
    if (checked.parameters?.length) return openForm({ ...template, parameters: checked.parameters }); // it has got some meanwhile
    if (problem !== undefined || !checked.job) {
      const place = [problem?.line ? T.submit.line(problem.line) : "", placeOnPage(problem?.place ?? ""), problem?.text ?? T.submit.notChecked];
      showRefusal(label, { code: "bad-job", text: place.filter(Boolean).join(" "), remedy: T.buttons.mend(template.file) });
      return;
    }
    if (await submitJob(label, checked.job, {}, newKey())) showNote(proposes() ? T.submit.proposed(label) : T.submit.submitted(label));
  } finally {
    pressedFile.value = "";
  }
}
