/** A program in G-code: its way and its reach, a line to start at, and what has to be confirmed. The gateway reads it. */

import type { JSX } from "preact";
import { useRef, useState } from "preact/hooks";
import type { CheckedProgram } from "../core/model.ts";
import * as T from "../texts.ts";
import { Act } from "./parts.tsx";

interface ProgramProps {
  program: CheckedProgram;
  sure: boolean;
  onSure: (sure: boolean) => void;
}

export function ProgramParts({ program, sure, onSure }: ProgramProps): JSX.Element {
  const { drawing, extents, confirm, notes } = program;
  const todo = program.approach ? [program.approach] : confirm;
  return (
    <div class="program">
      {drawing.start ? (
        <figure class="path">
          <svg viewBox="0 0 200 200" role="img" aria-label={T.preview.path(drawing.axes.join(", "))}>
            <rect class="frame" x="0.5" y="0.5" width="199" height="199" />
            <path class="rapid" d={drawing.rapid} />
            <path class="feed" d={drawing.feed} />
            <circle class="begin" cx={drawing.start[0]} cy={drawing.start[1]} r="3.5" />
          </svg>
          <small>{T.program.legend}</small>
        </figure>
      ) : null}
      <div>
        <table class="num" aria-label={T.program.reach}>
          {extents.map(({ axis, unit, min, max, limits, over }) => (
            <tr key={axis}>
              <th scope="row">{axis}</th>
              <td>{`${min} … ${max} ${unit}`}</td>
              <td class={over ? "reason bad" : "quiet"}>{over ? T.program.over(over, unit) : limits ? T.program.limits(limits.join(" … ")) : ""}</td>
            </tr>
          ))}
        </table>
        {notes.map((note) => (
          <p class="hint" key={note}>
            {note}
          </p>
        ))}
        {todo.length > 0 ? (
          <fieldset class="form block">
            <legend>{program.title}</legend>
            {todo.map((text) => (
              <p key={text}>{text}</p>
            ))}
            <label class="check">
              <input type="checkbox" checked={sure} onChange={(event) => onSure(event.currentTarget.checked)} />
              {program.sure}
            </label>
          </fieldset>
        ) : null}
      </div>
    </div>
  );
}

/** The text of a program; the line of the caret can be started at. */
export function ProgramText({ text, onStart }: { text: string; onStart: (line: number) => void }): JSX.Element {
  const box = useRef<HTMLTextAreaElement>(null);
  const [line, setLine] = useState(1);
  const look = (): void => setLine(text.slice(0, box.current?.selectionStart).split("\n").length);
  return (
    <details>
      <summary>{T.program.text}</summary>
      <textarea class="code" readOnly rows={10} aria-label={T.program.text} ref={box} value={text} onClick={look} onKeyUp={look} />
      <Act label={T.program.startAt(line)} onAct={() => onStart(line)} />
    </details>
  );
}
