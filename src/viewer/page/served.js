// What a page asks of its server. Pages in a file are without this.

async function answered(name) {
  const answer = await fetch(name);
  if (!answer.ok) throw new Error(`the server says: ${await answer.text()}`);
  return answer;
}

/** Columns of numbers. */
const fetched = async (name) => new Columns(await (await answered(name)).arrayBuffer());

/** Operations of the file of edits as `saved`, and how often it was saved as `saves`. */
const savedEdits = async () => (await answered("edits")).json();

/** Has the server write the text of edits; why it has not, if so. Throws if there is no server any more. */
async function saveEdits(scene, text) {
  const answer = await fetch(`edits/${scene.saves}`, { method: "POST", body: text });
  const said = await answer.text();
  // Another window may have saved.
  Object.assign(scene, answer.ok ? { saves: Number(said) } : await savedEdits());
  return answer.ok ? "" : `Not saved: ${said}`;
}
