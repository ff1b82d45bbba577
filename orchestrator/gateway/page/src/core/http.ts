/** Requests to the gateway besides the socket. Every failure is a refusal, with what to do about it. */

import type { Answer, Refusal } from "./model.ts";
import { noConnection, session } from "./stream.ts";
import * as T from "../texts.ts";

export async function get<R>(path: string): Promise<Answer<R>> {
  return request<R>(path, { method: "GET" });
}

/** Post a request. A reply with `refused` on status 200, as on the bus, is a refusal too. */
export async function post<R>(path: string, body: object = {}, repeatable = ""): Promise<Answer<R>> {
  const headers: Record<string, string> = { "Content-Type": "application/json" };
  const csrf = session.value?.csrf;
  if (csrf) headers["X-Tutti-CSRF"] = csrf;
  if (repeatable) headers["Idempotency-Key"] = repeatable;
  return request<R>(path, { method: "POST", headers, body: JSON.stringify(body) });
}

async function request<R>(path: string, options: RequestInit): Promise<Answer<R>> {
  let answer: Response;
  try {
    answer = await fetch(`v1/${path}`, { ...options, headers: { Accept: "application/json", ...options.headers } });
  } catch {
    return { refused: noConnection() };
  }
  let body: (R & { refused?: Refusal | null }) | null = null;
  try {
    body = (await answer.json()) as R & { refused?: Refusal | null };
  } catch {
    // no JSON: the status says what is wrong
  }
  if (body?.refused) return { refused: body.refused };
  if (!answer.ok || body === null) {
    return { refused: { code: `http-${answer.status}`, text: T.refusal.status(answer.status), remedy: T.refusal.statusRemedy } };
  }
  return { ok: body };
}

/** A key for a request that must not be carried out twice. */
export function newKey(): string {
  const bytes = crypto.getRandomValues(new Uint8Array(12));
  return `page-${Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("")}`;
}
