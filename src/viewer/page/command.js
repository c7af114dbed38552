// The `coseg edit` command that writes what was done as a new scene.

/** Quoted for a shell. */
const quoted = (text) => (/^[A-Za-z0-9_\-./=,:+]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);

/** Decimals that resolve a thousandth of the scene. */
function digitsOf({ low, high }) {
  const size = Math.hypot(...minus(high, low));
  return size > 0 ? Math.max(0, Math.min(12, Math.ceil(3 - Math.log10(size)))) : 6;
}

const rounded = (value, digits) => String(Number(value.toFixed(digits)));

/** The command line; nothing if there is nothing to write. */
function editCommand(scene, edits) {
  if (!edits.operations.length) return "";
  const folder = `${scene.title.replace(/[^\p{L}\p{N}_.-]+/gu, "-").replace(/^[-.]+/, "")}-edited`;
  const words = ["coseg", "edit", "--scene", quoted(scene.path), "--edits", quoted(scene.edits)];
  if (scene.names) words.push("--classes", quoted(scene.names));
  return [...words, "--out", quoted(`${folder}/scene.ply`)].join(" ");
}
