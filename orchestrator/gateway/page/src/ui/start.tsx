/** The start of what waits: what moves first is shown before, and the word for it counts for nothing else. */

import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { computed } from "@preact/signals";
import { shortId } from "../core/format.ts";
import { post } from "../core/http.ts";
import type { Answer, FirstMotion, StartPreview } from "../core/model.ts";
import { accept } from "../core/notices.ts";
import { whyNot } from "../core/rights.ts";
import { jobs, queue } from "../core/store.ts";
import { onPage } from "../texts.ts";
import * as T from "../texts.ts";
import { GetReady, mayBeUnready } from "./getready.tsx";
import { Act, closeDialog, Empty, openDialog } from "./parts.tsx";

/** What holds a job that had to wait for a cause, until its start is asked for. */
export const RESTART = "restart";

/** The jobs that are ready to begin, and wait for the word. */
export const readyJobs = computed(() => (queue.value.jobs ?? []).filter((job) => job.ready && (jobs.value[job.id]?.state ?? "queued") === "queued"));

/** One start that is asked for: of the queue, or of some jobs. */
interface Start {
  ids: string[];
  words: string;
}

function preview(start: Start): Promise<Answer<StartPreview>> {
  return post<StartPreview>("preview-start", { job_ids: start.ids });
}

function begin(start: Start, shown: string): Promise<Answer> {
  return start.ids.length > 0 ? post("release", { job_ids: start.ids, shown }) : post("start-queue", { shown });
}

/** Start the queue, with the word for all that is ready; first it is shown what moves. A queue in which nothing waits starts at once. */
export function askStart(): Promise<void> {
  return ask({ ids: [], words: T.queue.start });
}

export function askRelease(id: string, name: string): Promise<void> {
  return ask({ ids: [id], words: T.queue.releaseOf(name) });
}

async function ask(start: Start): Promise<void> {
  const found = accept(start.words, await preview(start));
  if (found === null) return;
  if ((found.motions ?? []).length === 0 && (found.lasting ?? []).length === 0 && (queue.value.waiting ?? 0) === 0) {
    const answer = await begin(start, found.shown);
    if (!isNotShown(answer)) return void accept(start.words, answer);
    const again = accept(start.words, await preview(start));
    if (again !== null) show(start, again, true);
    return;
  }
  show(start, found, false);
}

function isNotShown(answer: Answer): boolean {
  return "refused" in answer && answer.refused.code === "not-shown";
}

function show(start: Start, found: StartPreview, changed: boolean): void {
  openDialog(start.words, <StartDialog key={found.shown} start={start} first={found} changedBefore={changed} />);
}

/** While nothing can move yet, it is looked again: a cause may just be going away. */
const LOOK_MS = 1000;
/** What has just appeared must be seen before a press counts for it: the second press of a double one does not. */
const UNSEEN_MS = 600;

function StartDialog(props: { start: Start; first: StartPreview; changedBefore: boolean }): JSX.Element {
  const { start } = props;
  const [found, setFound] = useState(props.first);
  const [changed, setChanged] = useState(props.changedBefore);
  const [busy, setBusy] = useState(false);
  const [unseen, setUnseen] = useState(true);
  const motions = found.motions ?? [];
  const lasting = found.lasting ?? [];
  const look = async (): Promise<boolean> => {
    const next = accept(start.words, await preview(start));
    if (next !== null) setFound(next);
    return next !== null;
  };
  const confirm = async (): Promise<void> => {
    setBusy(true);
    const answer = await begin(start, found.shown);
    if (isNotShown(answer)) {
      setChanged(await look());
      setUnseen(true);
    } else if (accept(start.words, answer) !== null) closeDialog();
    setBusy(false);
  };
  const empty = motions.length === 0;
  useEffect(() => {
    if (!empty) return;
    const timer = setInterval(() => {
      void preview(start).then((answer) => {
        if (!("ok" in answer)) return;
        if ((answer.ok.motions ?? []).length > 0) setUnseen(true);
        setFound(answer.ok);
      });
    }, LOOK_MS);
    return () => clearInterval(timer);
  }, [empty]);
  useEffect(() => {
    if (!unseen) return;
    const timer = setTimeout(() => setUnseen(false), UNSEEN_MS);
    return () => clearTimeout(timer);
  }, [unseen]);
  const verb = start.ids.length > 0 ? "release" : "start-queue";
  const nothing = start.ids.length > 0 && motions.length === 0;
  return (
    <div class="menu start">
      {changed ? (
        <p class="reason warn" role="alert">
          <span aria-hidden="true">▲</span> {T.start.changed}
        </p>
      ) : null}
      <h3>{T.start.first}</h3>
      {motions.length === 0 ? <Empty text={T.start.nothing} /> : null}
      <ul class="cards" aria-label={T.start.first}>
        {motions.map((motion) => (
          <MotionCard key={motion.job_id} motion={motion} />
        ))}
      </ul>
      {lasting.length > 0 ? <h3>{T.start.lasting}</h3> : null}
      {lasting.length > 0 ? (
        <ul class="cards" aria-label={T.start.lasting}>
          {lasting.map((motion) => (
            <MotionCard key={motion.job_id} motion={motion} lasts />
          ))}
        </ul>
      ) : null}
      <div class="row finish">
        <Act
          label={motions.length > 0 ? T.start.confirm : start.words}
          kind="strong"
          motion
          why={busy ? T.start.busy : unseen ? T.start.unseen : nothing ? T.start.lasts : whyNot(verb)}
          onAct={() => void confirm()}
        />
        {lasting.length > 0 ? <Act label={T.start.again} onAct={() => void look()} /> : null}
        {lasting.length > 0 && mayBeUnready.value ? <GetReady ids={lasting.map((motion) => motion.job_id)} /> : null}
        <Act label={T.start.cancel} onAct={closeDialog} />
      </div>
    </div>
  );
}

function MotionCard({ motion, lasts = false }: { motion: FirstMotion; lasts?: boolean }): JSX.Element {
  const cause = motion.cause ? onPage(motion.cause) : "";
  return (
    <li class="card">
      <div class="cardtext">
        <div class="rowhead">
          <b>{motion.name}</b> <span class="quiet">{shortId(motion.job_id)}</span>
        </div>
        {lasts ? null : <p>{motion.text}</p>}
        {lasts || (motion.axes ?? []).length === 0 ? null : <p class="quiet">{T.start.axes((motion.axes ?? []).join(", "))}</p>}
        {cause ? <p class={`reason ${lasts ? "bad" : ""}`}>{lasts ? `▲ ${T.start.waitsFor(cause)}` : T.start.waitedFor(cause)}</p> : null}
      </div>
    </li>
  );
}
