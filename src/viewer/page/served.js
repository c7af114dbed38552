// What a page asks of its server. Pages in a file are without this.

async function answered(name) {
  const answer = await fetch(name);
  if (!answer.ok) throw new Error(`the server says: ${await answer.text()}`);
  return answer;
}

/** Columns of numbers. */
const fetched = async (name) => new Columns(await (await answered(name)).arrayBuffer());

/** The operations that the server's file of edits has. */
const savedEdits = async () => (await answered("edits")).json();

/** Has the server write the text of edits; why it has not, if so. Throws where there is no server any more. */
async function saveEdits(text) {
  const answer = await fetch("edits", { method: "POST", body: text });
  return answer.ok ? "" : `Not saved: ${await answer.text()}`;
}
