/** The queue: what waits for what, in which order; moved by dragging, or by "before …". */

import type { JSX } from "preact";
import { signal } from "@preact/signals";
import { dayAndTime, shortId, withoutAddress } from "../core/format.ts";
import { post } from "../core/http.ts";
import { noteOpen } from "../core/keys.ts";
import type { QueueEntry } from "../core/model.ts";
import { accept } from "../core/notices.ts";
import { firstOf, whyNot } from "../core/rights.ts";
import { jobs, queue } from "../core/store.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { Approval } from "./approval.tsx";
import { GetReady, mayBeUnready } from "./getready.tsx";
import { Act, Empty, Mark, openDialog, Panel } from "./parts.tsx";
import { askRelease, askStart, RESTART } from "./start.tsx";
import { NewJob } from "./submit.tsx";

/** A card that is being dragged, and the index that it would get. */
const drag = signal<{ id: string; to: number } | null>(null);

export function QueuePanel(): JSX.Element {
  const { stopped, journal, jobs: list = [], total = 0 } = queue.value;
  // A job's progress is newer than the list in which it waited.
  const waiting = list.filter((job) => job.state === "queued" && (jobs.value[job.id]?.state ?? "queued") === "queued");
  const listed = waiting.length;
  const unlisted = total - list.length;
  return (
    <Panel
      title={T.queue.title(listed + Math.max(0, unlisted))}
      area="queue"
      tools={
        <div class="chips">
          {stopped ? (
            <Act label={T.queue.start} kind="small" motion why={whyNot("start-queue")} onAct={() => void askStart()} />
          ) : (
            <>
              {waiting.some((job) => job.ready) ? (
                <Act label={T.start.begin} kind="small" motion why={whyNot("start-queue")} onAct={() => void askStart()} />
              ) : null}
              <Act label={T.queue.stop} kind="small" why={whyNot("stop-queue")} onAct={() => send("stop-queue", {}, T.queue.stop)} />
            </>
          )}
          {listed > 0 && mayBeUnready.value ? <GetReady ids={waiting.map((job) => job.id)} /> : null}
          <Act label={T.queue.add} kind="small" onAct={() => openDialog(T.submit.title, <NewJob />, true)} />
        </div>
      }
    >
      {stopped ? (
        <p class="reason warn">
          <span aria-hidden="true">■</span> {T.queue.stopped(stopped.reason, stopped.actor, dayAndTime(stopped.utc))}
        </p>
      ) : null}
      {journal ? <p class={journal.startsWith("waits") ? "reason warn" : "hint"}>{T.queue.journal(journal)}</p> : null}
      {listed === 0 ? <Empty text={T.queue.none} /> : null}
      <ol class="cards" aria-label={T.queue.list}>
        {waiting.map((job, index) => (
          <Card key={job.id} job={job} index={index} waiting={waiting} />
        ))}
      </ol>
      {unlisted > 0 ? <p class="hint">{T.queue.more(unlisted)}</p> : null}
    </Panel>
  );
}

function send(verb: string, body: object, what: string): Promise<boolean> {
  return post(verb, body).then((answer) => accept(what, answer) !== null);
}

function Card({ job, index, waiting }: { job: QueueEntry; index: number; waiting: QueueEntry[] }): JSX.Element {
  const dragged = drag.value;
  const whyOrder = whyNot("reorder");
  const id = [job.id];
  const held = Boolean(job.held_by);
  const lasts = job.held_by === RESTART && !job.ready;
  const shift = dragged && dragged.id !== job.id ? shiftOf(index, waiting, dragged) : "";
  const others = waiting.filter((each) => each.id !== job.id);
  return (
    <li class={`card queued ${dragged?.id === job.id ? "dragged" : ""} ${shift} ${held ? "held" : ""}`} data-job={job.id}>
      <span
        class="handle"
        title={whyOrder || T.queue.dragHint}
        aria-hidden="true"
        onPointerDown={(event) => (whyOrder ? undefined : beginDrag(event, job, waiting))}
        onContextMenu={(event) => event.preventDefault()}
      >
        ⠿
      </span>
      <div class="cardtext">
        <div class="rowhead">
          <span class="num place">{index + 1}.</span> <b>{job.name}</b> <span class="quiet">{shortId(job.id)}</span>
          <span class="quiet">{withoutAddress(job.actor)}</span>
        </div>
        <div class="facts">
          {termsOf(job).map((text) => (
            <span key={text} class="term">
              {text}
            </span>
          ))}
        </div>
      </div>
      <div class="cardtools">
        {job.proposed ? (
          <Act label={T.approval.review} name={T.approval.reviewOf(job.name)} kind="small" onAct={() => openDialog(T.approval.title(job.name), <Approval job={job} />, true)} />
        ) : held ? (
          <Act
            label={job.ready ? T.start.begin : T.queue.release}
            name={job.ready ? T.start.beginOf(job.name) : T.queue.releaseOf(job.name)}
            kind="small"
            motion
            why={firstOf(whyNot("release"), lasts ? T.start.lasts : "")}
            onAct={() => void askRelease(job.id, job.name)}
          />
        ) : (
          <Act label={T.queue.hold} name={T.queue.holdOf(job.name)} kind="small" why={whyNot("hold")} onAct={() => void send("hold", { job_ids: id }, T.queue.holdOf(job.name))} />
        )}
        <select
          aria-label={T.queue.beforeOf(job.name)}
          value=""
          disabled={whyOrder !== "" || others.length === 0}
          title={whyOrder || undefined}
          onKeyDown={openFirst}
          onChange={(event) => void moveTo(job, event.currentTarget.value, waiting)}
        >
          <option value="">{T.queue.before}</option>
          {others.map((each) => (
            <option key={each.id} value={each.id}>
              {`${each.name} ${shortId(each.id)}`}
            </option>
          ))}
          <option value={LAST}>{T.queue.last}</option>
        </select>
        <Act label="✕" name={T.job.verb("cancel", job.name)} kind="small" why={whyNot("cancel")} onAct={() => void send("cancel", { job_id: job.id }, T.job.verb("cancel", job.name))} />
      </div>
      {job.ready ? <Mark level="busy" text={T.start.ready} /> : null}
      <p class="reason">{onPage(job.reason) || T.queue.next}</p>
    </li>
  );
}

const LAST = "-";

/** A key opens the list; it must not choose from it unseen, as keys do in a closed list. */
function openFirst(event: KeyboardEvent & { currentTarget: HTMLSelectElement }): void {
  if (["Tab", "Enter", "Shift", "Control", "Alt", "Meta"].includes(event.key)) return;
  event.preventDefault();
  event.currentTarget.showPicker();
}

function termsOf(job: QueueEntry): string[] {
  const terms = job.terms ?? {};
  const texts: string[] = [];
  if (job.proposed) texts.push(T.queue.proposed);
  if (terms.priority) texts.push(T.queue.priority(terms.priority));
  if ((terms.repeat ?? 1) > 1) texts.push(T.queue.repeat(terms.repeat ?? 1));
  if (terms.at) texts.push(T.queue.at(dayAndTime(terms.at)));
  if (terms.after) texts.push(T.queue.after(shortId(terms.after)));
  if (terms.expires) texts.push(T.queue.expires(dayAndTime(terms.expires)));
  if (job.held_by && job.held_by !== RESTART && !job.reason.includes("held")) texts.push(T.queue.held(job.held_by));
  if (job.from_step) texts.push(T.queue.fromStep(job.from_step + 1));
  return texts;
}

function shiftOf(index: number, waiting: QueueEntry[], dragged: { id: string; to: number }): string {
  const from = waiting.findIndex((each) => each.id === dragged.id);
  if (from < index && index <= dragged.to) return "shiftup";
  if (dragged.to <= index && index < from) return "shiftdown";
  return "";
}

function middleOf(box: DOMRect): number {
  return box.top + box.height / 2;
}

/** Drag by pointer events, so that it is the same for mouse, pen and finger. */
function beginDrag(event: PointerEvent, job: QueueEntry, waiting: QueueEntry[]): void {
  const handle = event.currentTarget as HTMLElement;
  const list = handle.closest("ol");
  if (event.button !== 0 || list === null) return;
  event.preventDefault();
  handle.setPointerCapture(event.pointerId);
  // Places within the list: neither scrolling nor cards that make room change them.
  const top = list.getBoundingClientRect().top;
  const middles = [...list.children].map((card) => middleOf(card.getBoundingClientRect()) - top);
  const scroller = list.parentElement;
  const from = waiting.indexOf(job);
  drag.value = { id: job.id, to: from };
  const move = (moved: PointerEvent): void => {
    if (drag.value === null) return;
    if (scroller) scrollNear(scroller, moved.clientY);
    const at = moved.clientY - list.getBoundingClientRect().top;
    const above = middles.filter((middle, index) => index !== from && middle < at).length;
    if (above !== drag.value.to) drag.value = { id: job.id, to: above };
  };
  const finish = (done: boolean): void => {
    forgetOpen();
    handle.removeEventListener("pointermove", move);
    handle.removeEventListener("pointerup", drop);
    handle.removeEventListener("pointercancel", lose);
    handle.removeEventListener("lostpointercapture", lose);
    const now = drag.value;
    drag.value = null;
    if (!done || now === null || now.to === from) return;
    const rest = waiting.filter((each) => each.id !== job.id);
    void moveTo(job, rest[now.to]?.id ?? LAST, waiting);
  };
  const drop = (): void => finish(true);
  const lose = (): void => finish(false);
  const forgetOpen = noteOpen(lose);
  handle.addEventListener("pointermove", move);
  handle.addEventListener("pointerup", drop);
  handle.addEventListener("pointercancel", lose);
  handle.addEventListener("lostpointercapture", lose);
}

const NEAR_PX = 40;

/** Scroll a list whose edge the pointer has reached. */
function scrollNear(scroller: Element, y: number): void {
  const box = scroller.getBoundingClientRect();
  if (y < box.top + NEAR_PX) scroller.scrollTop -= NEAR_PX / 2;
  else if (y > box.bottom - NEAR_PX) scroller.scrollTop += NEAR_PX / 2;
}

/** Move a job before another one. To the end: those behind it go before it, one after the other. */
async function moveTo(job: QueueEntry, before: string, waiting: QueueEntry[]): Promise<void> {
  if (before === "") return;
  const what = T.queue.moveOf(job.name);
  if (before !== LAST) {
    await send("reorder", { job_id: job.id, before }, what);
    return;
  }
  for (const behind of waiting.slice(waiting.indexOf(job) + 1))
    if (!(await send("reorder", { job_id: behind.id, before: job.id }, what))) return;
}
