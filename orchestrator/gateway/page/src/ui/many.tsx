/** Of a fleet of many controllers: how many are in which mode, and which of them the page shows. */

import type { JSX } from "preact";
import { filter, first, isMany, matching, SHOWN } from "../core/many.ts";
import { counts } from "../core/store.ts";
import * as T from "../texts.ts";
import { Act, Mark } from "./parts.tsx";

export function ManyBar(): JSX.Element | null {
  if (!isMany.value) return null;
  const { modes = {}, troubles = {}, controllers = 0 } = counts.value ?? {};
  const all = matching.value.length;
  const last = Math.min(all, first.value + SHOWN);
  return (
    <section class="manybar row" aria-label={T.many.title}>
      <input type="search" aria-label={T.many.filter} placeholder={T.many.filter} value={filter.value} onInput={(event) => (filter.value = event.currentTarget.value)} />
      <Act label="‹" name={T.many.before} kind="small" why={first.value > 0 ? "" : T.many.noMore} onAct={() => (first.value = Math.max(0, first.value - SHOWN))} />
      <span class="num" data-testid="many-range">{T.many.range(all ? first.value + 1 : 0, last, all, controllers)}</span>
      <Act label="›" name={T.many.after} kind="small" why={last < all ? "" : T.many.noMore} onAct={() => (first.value += SHOWN)} />
      <span class="quiet">{Object.entries(modes).filter(([mode]) => !(mode in troubles)).map(([mode, count]) => T.many.count(count, T.mode(mode))).join(" · ")}</span>
      {Object.entries(troubles).map(([trouble, count]) => (
        <Mark key={trouble} level="bad" text={T.many.count(count, trouble)} />
      ))}
    </section>
  );
}
