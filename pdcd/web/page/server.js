// Questions to the server of this page.

/** What went wrong, as the server told it. */
export class Trouble extends Error {
  constructor(error) {
    const where = error.device ? `${error.device}: ` : "";
    super(`${where}${error.message}${error.hint ? `\n${error.hint}` : ""}`);
    this.kind = error.kind;
  }
}

// What lets this page in comes behind the # of its address, which no server is sent, and is kept
// for this tab where no page of another address can read it; perhaps with what to begin with.
const [token, first = ""] = location.hash.slice(1).split(".");
if (token) {
  sessionStorage.setItem("token", token);
  history.replaceState(null, "", location.pathname);
}

/** What the page is to begin with, once. */
export const begin = first;

async function answer(address, options = {}) {
  const headers = { Authorization: `Bearer ${sessionStorage.getItem("token") ?? ""}` };
  let response;
  try {
    response = await fetch(address, { headers, credentials: "omit", cache: "no-store", ...options });
  } catch {
    throw new Trouble({ kind: "gone", message: "pdcd web does not answer" });
  }
  if (response.ok) return response;
  let told = {};
  try {
    told = await response.json();
  } catch {} // the status says enough
  throw new Trouble(told.error ?? { kind: "gone", message: `pdcd web answered ${response.status}` });
}

/** Ask for something that changes nothing. */
export const get = async (address) => (await answer(address)).json();

/** Have something done. */
export const post = async (address, body = {}) =>
  (await answer(address, { method: "POST", body: JSON.stringify(body) })).json();

/** A picture, as an address for this page alone. */
export const picture = async (address) => URL.createObjectURL(await (await answer(address)).blob());

/** Each message that the server tells, until it tells no more. */
export async function* news(address, options) {
  const { body } = await answer(address, options);
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    const lines = (text + value).split("\n");
    text = lines.pop();
    for (const line of lines) if (line.startsWith("data: ")) yield JSON.parse(line.slice(6));
  }
}
