/** The axis table: where each axis is and goes, why it is not ready what to do, and its holder. */

import type { JSX } from "preact";
import { computed, signal } from "@preact/signals";
import { useLayoutEffect, useMemo, useRef } from "preact/hooks";
import { attention, rankOf } from "../core/attention.ts";
import { formatUnit, formatValue, withoutAddress } from "../core/format.ts";
import { held } from "../core/manual.ts";
import { isMany, shown } from "../core/many.ts";
import { plotted } from "../core/look.ts";
import { readinessOf } from "../core/ready.ts";
import { allAxes, jobs, leases, owners, permits, queue, type AxisStore, type ControllerStore } from "../core/store.ts";
import { pageAge } from "../core/stream.ts";
import * as T from "../texts.ts";
import { AxisMenu } from "./axismenu.tsx";
import { GetReady, unready } from "./getready.tsx";
import { MoveDialog } from "./movedialog.tsx";
import { PlaneSwitch } from "./plane.tsx";
import { ZonesSwitch } from "./zones.tsx";
import { Act, Empty, Mark, openDialog, Panel } from "./parts.tsx";

/** With more axes than this the table is dense, and what needs a look comes first. */
const MANY = 8;
/** A pointer is over the table, or the keyboard is in it: rows stay where they are. */
const stays = signal(false);

export function AxisTable({ onChoose, chosen }: { onChoose?: (axis: string) => void; chosen?: string }): JSX.Element {
  const many = allAxes().length > MANY;
  const last = useRef<ControllerStore[]>([]);
  const all = isMany.value ? owners.value.filter((owner) => shown.value.includes(owner.id)) : owners.value;
  const known = last.current.length === all.length && last.current.every((controller) => all.includes(controller));
  if (!many) last.current = all;
  else if (!stays.value || !known) last.current = [...all].sort((a, b) => rankOfController(a) - rankOfController(b));
  // The queue has a button for what its jobs need, and Set-up one for all axes.
  const needsReady = !onChoose && unready.value.length > 0 && (queue.value.waiting ?? 0) === 0;
  const table = useRef<HTMLTableElement>(null);
  const moving = many && Object.values(attention.value).includes(0);
  useLayoutEffect(() => {
    if (moving && !stays.value) table.current?.parentElement?.scrollTo(0, 0);
  }, [moving, stays.value, last.current.map((controller) => controller.id).join()]);
  return (
    <Panel title={T.axes.title} area="axes" tools={
        <div class="chips">
          {needsReady ? <GetReady ids={[]} /> : null}
          <PlaneSwitch />
          <ZonesSwitch />
        </div>
      }
    >
      {all.length === 0 ? (
        <Empty text={T.axes.none} />
      ) : (
        <table
          ref={table}
          class={`axistable ${many ? "dense" : ""}`}
          onPointerEnter={(event) => (stays.value = event.pointerType === "mouse")}
          onPointerLeave={() => (stays.value = false)}
          onFocusIn={(event) => (stays.value = stays.value || (event.target as Element).matches(":focus-visible"))}
          onFocusOut={(event) => (stays.value = event.currentTarget.matches(":hover"))}
        >
          <thead>
            <tr>
              <th scope="col">{T.axes.axis}</th>
              <th scope="col" class="num">
                {T.axes.position}
              </th>
              <th scope="col" class="num">
                {T.axes.target}
              </th>
              <th scope="col">{T.axes.state}</th>
              <th scope="col">{T.axes.holder}</th>
              <th scope="col">
                <span class="hidden">{T.axes.menu}</span>
              </th>
            </tr>
          </thead>
          {last.current.map((controller) => (
            <ControllerRows key={controller.id} controller={controller} onChoose={onChoose} chosen={chosen} />
          ))}
        </table>
      )}
    </Panel>
  );
}

function rankOfController(controller: ControllerStore): number {
  return Math.min(...controller.axes.value.map((axis) => rankOf(axis.id)), Number.MAX_SAFE_INTEGER);
}

interface RowsProps {
  controller: ControllerStore;
  onChoose?: ((axis: string) => void) | undefined;
  chosen?: string | undefined;
}

function ControllerRows({ controller, onChoose, chosen }: RowsProps): JSX.Element {
  const rest = controller.rest.value;
  const age = Math.max(controller.age.value, pageAge.value);
  const old = age >= 1;
  return (
    <tbody class={old ? "stale" : ""} data-controller={controller.id}>
      <tr class="controller">
        <th scope="rowgroup" colSpan={6}>
          <b>{controller.id}</b> <span>{rest.make}</span> <span>{T.mode(rest.present ? rest.mode : "absent")}</span>
          {old ? <span class="age">{T.age(age)}</span> : null}
        </th>
      </tr>
      {controller.axes.value.map((axis) => (
        <AxisRow key={axis.id} axis={axis} controller={controller} onChoose={onChoose} chosen={chosen === axis.id} />
      ))}
    </tbody>
  );
}

interface RowProps {
  axis: AxisStore;
  controller: ControllerStore;
  onChoose?: ((axis: string) => void) | undefined;
  chosen: boolean;
}

function AxisRow({ axis, controller, onChoose, chosen }: RowProps): JSX.Element {
  const flags = axis.flags.value;
  const ready = readinessOf(axis.id, flags, controller.rest.value, permits.value);
  // Texts that change often are bound to their signals: the row is not rendered again for them.
  const position = useMemo(() => computed(() => formatValue(axis.position.value, axis.flags.value.unit)), [axis]);
  const holder = holderOf(axis);
  const target = useMemo(() => computed(() => formatTarget(axis)), [axis]);
  return (
    <tr class={`axis ${ready.level} ${chosen ? "chosen" : ""}`} data-axis={axis.id} data-testid={`axis-${axis.id}`}>
      <th scope="row">
        {onChoose ? (
          <button type="button" class="link" aria-pressed={chosen} onClick={() => onChoose(axis.id)}>
            {axis.id}
          </button>
        ) : (
          axis.id
        )}
      </th>
      <td class="num position" data-testid={`position-${axis.id}`}>
        <span class="value">{position}</span> <span class="unit">{formatUnit(flags.unit)}</span>
      </td>
      <td class={`num target ${flags.target === undefined ? "none" : ""}`}>
        <span class="value">{target}</span>
      </td>
      <td class="state" title={ready.remedy ? `${ready.text}: ${ready.remedy}` : undefined}>
        <Mark level={ready.level} text={ready.text} />
        {ready.remedy ? <small class="remedy">{ready.remedy}</small> : null}
      </td>
      <td class={`holder ${holder.name === NONE ? "none" : ""}`} title={holder.whole}>
        {holder.name}
        {holder.by ? <small class="remedy">{holder.by}</small> : null}
      </td>
      <td class="tools">
        <Act
          label={T.axes.go}
          kind="small"
          name={T.axes.goOf(axis.id)}
          onAct={() => openDialog(T.axes.moving(axis.id), <MoveDialog axis={axis} controller={controller} />)}
        />
        <Act
          label="⋯"
          kind="small"
          name={T.axes.menuOf(axis.id)}
          onAct={() => openDialog(T.axes.menuTitle(axis.id), <AxisMenu axis={axis} controller={controller} />)}
        />
        <Act
          label="∿"
          kind="small"
          name={T.axes.plot(axis.id)}
          pressed={plotted.value.includes(axis.id)}
          onAct={() => togglePlot(axis.id)}
        />
      </td>
    </tr>
  );
}

function formatTarget(axis: AxisStore): string {
  const target = axis.target.value;
  return target === null ? "–" : formatValue(target, axis.flags.value.unit);
}

const MOST_PLOTS = 6;

export function togglePlot(id: string): void {
  const now = plotted.value;
  plotted.value = now.includes(id) ? now.filter((each) => each !== id) : [...now, id].slice(-MOST_PLOTS);
}

const NONE = "–";

export interface Holder {
  name: string;
  by: string;
  whole: string;
}

/** What may move it now: this page, a user, a job. */
export function holderOf(axis: AxisStore): Holder {
  if (held.value.includes(axis.id)) return { name: T.axes.you, by: "", whole: "" };
  const lease = leases.value[axis.id] ?? leases.value[axis.controller];
  if (!lease?.holder) return { name: NONE, by: "", whole: "" };
  const job = jobs.value[lease.holder];
  const by = withoutAddress(lease.actor);
  const whole = [lease.holder, lease.actor, lease.what].filter(Boolean).join(", ");
  if (job) return { name: T.axes.heldByJob(job.name), by, whole };
  return lease.what ? { name: by, by: lease.what, whole } : { name: by, by: "", whole };
}
