// The `coseg edit` command that writes what the page shows.

/** Quoted for a shell. */
const quoted = (text) => (/^[A-Za-z0-9_\-./=,:+]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);

/** Decimals that resolve a thousandth of the scene. */
function digitsOf({ low, high }) {
  const size = Math.hypot(...minus(high, low));
  return size > 0 ? Math.max(0, Math.min(12, Math.ceil(3 - Math.log10(size)))) : 6;
}

const rounded = (value, digits) => String(Number(value.toFixed(digits)));

/** A name where it means this object alone and can stand in a list, otherwise the id. */
function spoken(scene, { id, name }) {
  const others = scene.objects.filter((object) => object.id !== id);
  const shared = others.some((object) => object.name === name || object.name?.replace(/ \d+$/, "") === name);
  const plain = name && name.trim() === name && !/[,=]|^-|^\d+$/.test(name);
  return plain && !shared ? name : String(id);
}

/** The command line, or nothing where the scene is as it was or nothing would be left of it. */
function editCommand(scene, objects) {
  const hidden = scene.objects.filter((_, i) => !objects[i].shown);
  const shown = scene.objects.filter((_, i) => objects[i].shown);
  const changed = shown.map((object) => [object, objects[scene.objects.indexOf(object)]]);
  const turned = changed.filter(([, state]) => state.turned);
  const digits = digitsOf(scene.extent);
  const offsets = changed.map(([object, { offset }]) => [object, offset.map((v) => rounded(v, digits))]);
  const moved = offsets.filter(([, offset]) => offset.some((v) => v !== "0"));
  if (!scene.labelled || !shown.length || !(hidden.length + turned.length + moved.length)) return "";
  const folder = `${scene.title.replace(/[^\p{L}\p{N}_.-]+/gu, "-").replace(/^[-.]+/, "")}-edited`;
  const words = ["coseg", "edit", "--scene", quoted(scene.path), "--out", quoted(`${folder}/scene.ply`)];
  if (scene.names) words.push("--classes", quoted(scene.names));
  const list = (some) => quoted(some.map((object) => spoken(scene, object)).join(","));
  if (hidden.length > shown.length) words.push("--keep", list(shown));
  else if (hidden.length) words.push("--remove", list(hidden));
  for (const [object, { axis, degrees }] of turned) {
    words.push("--turn", quoted(`${spoken(scene, object)}=${axis.argument},${rounded(degrees, 3)}`));
  }
  for (const [object, offset] of moved) {
    words.push("--move", quoted(`${spoken(scene, object)}=${offset.join(",")}`));
  }
  return words.join(" ");
}
