// What `coseg edit` makes of the scene what the page shows.

/** As a shell takes it. */
const quoted = (text) => (/^[A-Za-z0-9_\-./=,:+]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);
/** At most `digits` after the point. */
const rounded = (value, digits = 3) => String(Number(value.toFixed(digits)));

/** A name where it means this object alone and can stand in a list, otherwise the id. */
function spoken(scene, object) {
  const { id, name } = object;
  const shared = scene.objects.some((o) => o.id !== id && (o.name === name || o.name?.replace(/ \d+$/, "") === name));
  return name && !shared && !/[,=]/.test(name) && name.trim() === name && !/^\d+$/.test(name) ? name : String(id);
}

/** The command line, or nothing where the scene is as it was. */
function editCommand(scene, objects) {
  const hidden = scene.objects.filter((_, i) => !objects[i].shown);
  const shown = scene.objects.filter((_, i) => objects[i].shown);
  const moved = scene.objects.filter((_, i) => objects[i].shown && objects[i].moved);
  if (!shown.length || (!hidden.length && !moved.length)) return "";
  const words = ["coseg", "edit", "--scene", quoted(scene.path), "--out", "edited/scene.ply"];
  const list = (some) => quoted(some.map((object) => spoken(scene, object)).join(","));
  if (hidden.length > shown.length) words.push("--keep", list(shown));
  else if (hidden.length) words.push("--remove", list(hidden));
  for (const object of moved) {
    const { offset } = objects[scene.objects.indexOf(object)];
    words.push("--move", quoted(`${spoken(scene, object)}=${offset.map((v) => rounded(v)).join(",")}`));
  }
  return words.join(" ");
}
