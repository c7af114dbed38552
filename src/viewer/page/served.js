// What a page asks of its server. Pages in a file are without this.

/** Columns of numbers. */
async function fetched(name) {
  const answer = await fetch(name);
  if (!answer.ok) throw new Error(`the server says: ${await answer.text()}`);
  return new Columns(await answer.arrayBuffer());
}

/** Why the server has not written the text of edits; nothing if it has. */
async function notSaved(text) {
  try {
    const answer = await fetch("edits", { method: "POST", body: text });
    return answer.ok ? "" : `Not saved: ${await answer.text()}`;
  } catch {
    return "Not saved: the server has ended.";
  }
}
