/** The start strip: when each axis of a step started, as intervals around T0, with what was promised behind them. */

import type { JSX } from "preact";
import { formatNs } from "../core/format.ts";
import type { StepReport } from "../core/model.ts";
import * as T from "../texts.ts";

interface Line {
  name: string;
  from: number;
  to: number;
  promised?: { from: number; to: number };
}

export function linesOf(step: StepReport): Line[] {
  const t0 = step.t0_fleet_ns;
  if (t0 === null || t0 === undefined) return [];
  const lines: Line[] = [];
  for (const [member, report] of Object.entries(step.members ?? {})) {
    const budget = step.budget?.members[member];
    for (const [axis, evidence] of Object.entries(report.evidence ?? {})) {
      const start = evidence.modelled ?? evidence.start;
      const line: Line = {
        name: axis.includes(".") ? axis : `${member}.${axis}`,
        from: start.earliest_ns - t0,
        to: start.latest_ns - t0,
      };
      if (budget) line.promised = { from: budget.earliest_ns, to: budget.latest_ns };
      lines.push(line);
    }
  }
  return lines;
}

export function StartStrip({ step }: { step: StepReport }): JSX.Element | null {
  const lines = linesOf(step);
  if (lines.length === 0) return null;
  const ends = lines.flatMap((line) => [line.from, line.to, line.promised?.from ?? 0, line.promised?.to ?? 0]);
  const reach = Math.max(1000, ...ends.map(Math.abs)) * 1.08;
  const place = (ns: number): number => ((ns + reach) / (2 * reach)) * 100;
  const span = (from: number, to: number): { left: string; width: string } => ({
    left: `${place(from)}%`,
    width: `${Math.max(0.6, place(to) - place(from))}%`,
  });
  return (
    <figure class="strip">
      <figcaption>{T.strip.caption}</figcaption>
      {lines.map((line) => (
        <div class="stripline" key={line.name}>
          <span class="name">{line.name}</span>
          <span class="lane" role="img" aria-label={T.strip.line(line.name, formatNs(line.from), formatNs(line.to))}>
            {line.promised ? <i class="promised" style={span(line.promised.from, line.promised.to)} /> : null}
            <i class="zero" />
            <i class="started" style={span(line.from, line.to)} />
          </span>
          <span class="num">
            {formatNs(line.from)} … {formatNs(line.to)}
          </span>
        </div>
      ))}
      <div class="stripline scale" aria-hidden="true">
        <span />
        <span class="lane">
          <span>{formatNs(-reach)}</span>
          <span>T0</span>
          <span>{formatNs(reach)}</span>
        </span>
        <span />
      </div>
    </figure>
  );
}
