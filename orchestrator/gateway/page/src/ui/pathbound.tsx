/** A path, before it runs or after it: length and time, and how far the axes may be off it, by term and member. */

import type { JSX } from "preact";
import { formatSeconds, formatUnit } from "../core/format.ts";
import type { PathReport } from "../core/model.ts";
import * as T from "../texts.ts";

const TERMS = ["profile-fit", "execution", "start", "clock"] as const;

export function PathFacts({ path }: { path: PathReport }): JSX.Element {
  const { bound } = path;
  const unit = formatUnit(path.unit);
  const size = (value: number): string => `${Number(value.toPrecision(3))} ${unit}`;
  const members = [...new Set(bound?.terms.map((term) => term.member ?? ""))];
  return (
    <div class="pathfacts">
      <p class="facts num">
        <span>{T.path.course(`${Number(path.length.toPrecision(6))} ${unit}`, formatSeconds(path.duration_s), path.frame ?? "")}</span>
        {bound ? <span>{T.path.bound(size(bound.predicted), size(bound.tolerance))}</span> : null}
        {typeof bound?.proven === "number" ? <span>{T.path.proven(size(bound.proven))}</span> : null}
      </p>
      {bound ? (
        <details>
          <summary>{T.path.terms}</summary>
          <table class="num">
            <thead>
              <tr>
                <th scope="col">{T.path.member}</th>
                {TERMS.map((name) => (
                  <th scope="col" key={name}>
                    {T.path.term[name]}
                  </th>
                ))}
              </tr>
            </thead>
            <tbody>
              {members.map((member) => (
                <tr key={member}>
                  <th scope="row">{member || T.path.plan}</th>
                  {TERMS.map((name) => {
                    const term = bound.terms.find((each) => each.name === name && (each.member ?? "") === member);
                    return <td key={name}>{term ? size(term.size) : "–"}</td>;
                  })}
                </tr>
              ))}
            </tbody>
          </table>
        </details>
      ) : null}
    </div>
  );
}
