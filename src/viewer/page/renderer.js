// Draws the Gaussians with WebGL 2: sorted quads blended back to front into half floats. An instance is a batch of quads:
// an instance for each quad takes far longer, on a CPU above all.

const PARTS_WIDE = 256; // in a row of their texture, as in splat.vert
const BATCH = 256; // quads of an instance, as in splat.vert
const SELECTED = 0x80000000; // added to the part of a selected Gaussian, as in splat.vert

class Renderer {
  constructor(canvas, scene, shaders) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("This browser has no WebGL 2.");
    this.gl = gl;
    this.canvas = canvas;
    this.scene = scene;
    // Otherwise eight bits must do.
    this.halfFloats = Boolean(gl.getExtension("EXT_color_buffer_float") ?? gl.getExtension("EXT_color_buffer_half_float"));
    this.splats = this.program(shaders.splatVertex, shaders.splatFragment);
    this.screen = this.program(shaders.screenVertex, shaders.screenFragment);

    const rows = scene.blockRows * scene.steps;
    if (rows > gl.getParameter(gl.MAX_TEXTURE_SIZE)) {
      const most = (gl.getParameter(gl.MAX_TEXTURE_SIZE) * TEXTURE_WIDTH) / TEXELS;
      throw new Error(`The scene has ${scene.gaussians} Gaussians; this device shows ${most} at most.`);
    }
    const size = [TEXTURE_WIDTH, rows];
    this.geometry = this.texture(gl.RGBA32F, gl.RGBA, gl.FLOAT, ...size, null);
    this.colours = this.texture(gl.RGBA32UI, gl.RGBA_INTEGER, gl.UNSIGNED_INT, ...size, null);
    for (let block = 0; block < scene.received; block++) this.upload(block);
    this.parts = gl.createTexture();
    /** Of textures with a word for each Gaussian. */
    this.wordSize = [TEXTURE_WIDTH, Math.ceil(scene.gaussians / TEXTURE_WIDTH)];
    this.partOf = this.texture(gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT, ...this.wordSize, null);
    this.order = this.texture(gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT, ...this.wordSize, null);

    // Two triangles of the four corners of each quad.
    const corners = Array.from({ length: 6 * BATCH }, (_, i) => 4 * Math.floor(i / 6) + [0, 1, 2, 2, 1, 3][i % 6]);
    this.quads = gl.createVertexArray();
    gl.bindVertexArray(this.quads);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint16Array(corners), gl.STATIC_DRAW);
    this.nothing = gl.createVertexArray();
    this.target = null;
  }

  /** Takes a block that has come to the scene. */
  upload(block) {
    const { gl, scene } = this;
    const { blockRows } = scene;
    const place = [0, blockRows * block, TEXTURE_WIDTH, blockRows];
    gl.bindTexture(gl.TEXTURE_2D, this.geometry);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, ...place, gl.RGBA, gl.FLOAT, scene.block(scene.geometry, block));
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, ...place, gl.RGBA_INTEGER, gl.UNSIGNED_INT, scene.block(scene.colours, block));
  }

  program(vertex, fragment) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source.trim());
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      uniforms[name] = gl.getUniformLocation(program, name);
    }
    return { program, uniforms };
  }

  texture(internal, format, type, width, height, values) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, internal, width, height, 0, format, type, values);
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    return texture;
  }

  /** What is blended into, of this size. */
  resize(width, height) {
    const { gl, target } = this;
    if (target && target.width === width && target.height === height) return;
    if (target) {
      gl.deleteTexture(target.picture);
      gl.deleteFramebuffer(target.buffer);
    }
    const [internal, type] = this.halfFloats ? [gl.RGBA16F, gl.HALF_FLOAT] : [gl.RGBA8, gl.UNSIGNED_BYTE];
    const picture = this.texture(internal, gl.RGBA, type, width, height, null);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
    const buffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, picture, 0);
    if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) !== gl.FRAMEBUFFER_COMPLETE && this.halfFloats) {
      this.halfFloats = false;
      this.target = { picture, buffer, width: 0, height: 0 };
      this.resize(width, height);
      return;
    }
    this.target = { picture, buffer, width, height };
  }

  /** The next pictures draw in this order. */
  setOrder(order) {
    const { gl } = this;
    const size = [TEXTURE_WIDTH, Math.ceil(order.length / TEXTURE_WIDTH)];
    gl.bindTexture(gl.TEXTURE_2D, this.order);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, ...size, gl.RED_INTEGER, gl.UNSIGNED_INT, order.drawn);
    this.count = order.length;
  }

  /** Where parts are, their colours and which are chosen; the part of each Gaussian, and whether it is selected. */
  setParts(state, selection, chosen) {
    const { gl } = this;
    const size = [TEXELS * PARTS_WIDE, Math.ceil(state.parts.length / PARTS_WIDE)];
    const values = new Float32Array(FLOATS * PARTS_WIDE * size[1]);
    state.parts.forEach(({ object, pose: { rotation, shift } }, i) => {
      for (let k = 0; k < 3; k++) values.set([...row(rotation, k), shift[k]], FLOATS * i + 4 * k);
      const color = state.objects.get(object)?.color ?? [0, 0, 0];
      values.set([...times(1 / 255, color), chosen.has(object) ? 1 : 0], FLOATS * i + 12);
    });
    gl.deleteTexture(this.parts);
    this.parts = this.texture(gl.RGBA32F, gl.RGBA, gl.FLOAT, ...size, values);

    const words = new Uint32Array(this.wordSize[0] * this.wordSize[1]);
    words.set(state.partOf);
    if (selection.count) selection.flags.forEach((flag, i) => flag && (words[i] += SELECTED));
    gl.bindTexture(gl.TEXTURE_2D, this.partOf);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, ...this.wordSize, gl.RED_INTEGER, gl.UNSIGNED_INT, words);
  }

  /** Draws what `camera` sees; its image is `scale` of the canvas. `painted` is the share of the labels' colours. */
  draw(camera, painted, background) {
    const { gl, canvas, scene } = this;
    this.resize(camera.width, camera.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.buffer);
    gl.viewport(0, 0, camera.width, camera.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const { program, uniforms } = this.splats;
    gl.useProgram(program);
    ["geometry", "colours", "parts", "partOf", "order"].forEach((name, i) => {
      gl.activeTexture(gl.TEXTURE0 + i);
      gl.bindTexture(gl.TEXTURE_2D, this[name]);
      gl.uniform1i(uniforms[name], i);
    });
    gl.uniform1i(uniforms.count, this.count);
    gl.uniformMatrix3fv(uniforms.rotation, true, camera.rotation);
    gl.uniform3fv(uniforms.center, camera.center);
    gl.uniform2f(uniforms.focal, camera.fx, camera.fy);
    gl.uniform2f(uniforms.principal, camera.cx, camera.cy);
    gl.uniform2f(uniforms.size, camera.width, camera.height);
    gl.uniform2i(uniforms.blocks, scene.steps, (scene.blockRows * TEXTURE_WIDTH) / TEXELS);
    gl.uniform1i(uniforms.degree, scene.degree);
    gl.uniform1f(uniforms.painted, painted);
    gl.uniform3f(uniforms.chosen, 1, 0.85, 0.35);
    gl.uniform3f(uniforms.selected, 1, 0.2, 0.75);
    gl.uniform1f(uniforms.alphaMax, scene.alpha_max);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.bindVertexArray(this.quads);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * BATCH, gl.UNSIGNED_SHORT, 0, Math.ceil(this.count / BATCH));

    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.disable(gl.BLEND);
    gl.useProgram(this.screen.program);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.target.picture);
    gl.uniform1i(this.screen.uniforms.picture, 0);
    gl.uniform2f(this.screen.uniforms.size, canvas.width, canvas.height);
    gl.uniform3fv(this.screen.uniforms.background, background);
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
