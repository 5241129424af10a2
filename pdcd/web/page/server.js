// Questions to the server of this page.

/** What went wrong, as the server told it. */
export class Trouble extends Error {
  constructor(error) {
    const where = error.device ? `${error.device}: ` : "";
    super(`${where}${error.message}${error.hint ? `\n${error.hint}` : ""}`);
    this.kind = error.kind;
  }
}

async function answer(address, options) {
  let response;
  try {
    response = await fetch(address, { credentials: "same-origin", cache: "no-store", ...options });
  } catch {
    throw new Trouble({ kind: "gone", message: "pdcd web does not answer" });
  }
  let told;
  try {
    told = await response.json();
  } catch {
    throw new Trouble({ kind: "gone", message: `pdcd web answered ${response.status}` });
  }
  if (!response.ok) throw new Trouble(told.error ?? { message: `status ${response.status}` });
  return told;
}

/** Ask for something that changes nothing. */
export const get = (address) => answer(address);

/** Have something done. */
export const post = (address, body = {}) =>
  answer(address, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify(body),
  });
