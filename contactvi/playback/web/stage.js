// The picture: bodies with their shapes, ground and walls, light. It draws when something has changed.

const BACKGROUND = 0xf5f7f9, GRID = 0x8d99a8;

class Stage {
  constructor(pane, view, source) {
    this.pane = pane;
    this.view = view;
    this.source = source;
    this.renderer = new THREE.WebGLRenderer({antialias: true, alpha: true, preserveDrawingBuffer: true});
    this.renderer.outputEncoding = THREE.sRGBEncoding;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFSoftShadowMap;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.renderer.setClearColor(BACKGROUND);
    pane.prepend(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(30, 1, 0.01, 100);
    this.camera.up.set(0, 0, 1);
    this.scene.add(this.camera);
    this.dirty = true;
    this.materials = new Map();
    this.geometries = new Map();
    this.lines = [];
    this.bodies = source.bodies.map(body => {
      const group = new THREE.Group();
      group.name = body.name;
      group.userData = {center: new THREE.Vector3(), radius: 0};
      this.scene.add(group);
      return group;
    });
    for (const shape of source.shapes) { this.add(shape); }
    this.bodies.forEach(measure);
    const sizes = this.bodies.map(group => group.userData.radius).filter(radius => radius > 0).sort((a, b) => a - b);
    this.ordinary = sizes.length ? sizes[sizes.length >> 1] : view.radius;  // [m] radius of an ordinary body
    this.light();
    new ResizeObserver(() => this.resize()).observe(pane);
    this.resize();
  }

  resize() {
    const width = Math.max(1, this.pane.clientWidth), height = Math.max(1, this.pane.clientHeight);
    if (width === this.width && height === this.height) { return; }
    [this.width, this.height] = [width, height];
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (this.resized) { this.resized(); }
    this.draw();
  }

  // --- shapes ---------------------------------------------------------------------------------------------------

  add(shape) {
    if (shape.shape === "line") { this.addLine(shape); return; }
    const place = new THREE.Matrix4().set(...shape.placement), group = this.bodies[shape.body];
    if (shape.shape === "halfspace") { this.addHalfspace(shape, place, group); return; }
    const marked = ["sphere", "ellipsoid"].includes(shape.shape) && !this.source.bodies[shape.body].fixed;
    const mesh = new THREE.Mesh(this.geometry(shape, marked), this.material(shape, marked));
    mesh.name = shape.name;
    mesh.castShadow = mesh.receiveShadow = shape.opacity === 1;
    mesh.applyMatrix4(place);
    group.add(mesh);
  }

  geometry(shape, marked) {
    if (shape.shape === "mesh") { return meshGeometry(shape); }
    const key = [shape.shape, shape.sizes, marked].join();
    if (!this.geometries.has(key)) { this.geometries.set(key, plainGeometry(shape.shape, shape.sizes, marked)); }
    return this.geometries.get(key);
  }

  material(shape, marked) {
    const open = shape.shape === "mesh" && !shape.closed;  // seen from inside, too
    const key = [shape.color, shape.opacity, marked, shape.shape === "mesh", open].join();
    if (!this.materials.has(key)) {
      const clear = shape.opacity < 1, color = new THREE.Color(shape.color).convertSRGBToLinear();
      const material = new THREE.MeshPhongMaterial({color, shininess: 30, specular: 0x1c1c1c, opacity: shape.opacity,
        transparent: clear, depthWrite: !clear, vertexColors: marked,
        side: open && !clear ? THREE.DoubleSide : THREE.FrontSide,
        shadowSide: shape.shape === "mesh" && !clear ? THREE.DoubleSide : null});
      material.onBeforeCompile = withOutline;
      this.materials.set(key, material);
    }
    return this.materials.get(key);
  }

  addLine(shape) {
    const radius = 0.004 * this.view.radius;
    const rod = new THREE.CylinderGeometry(radius, radius, 1, 12).rotateX(Math.PI / 2).translate(0, 0, 0.5);
    const pieces = shape.points.slice(1).map(() => {
      const mesh = new THREE.Mesh(rod, this.material(shape, false));
      mesh.castShadow = true;
      this.scene.add(mesh);
      return mesh;
    });
    this.lines.push({name: shape.name, shape, pieces, ends: shape.points.map(() => new THREE.Vector3())});
  }

  // The ground is a disc that fades out; a wall is as large as what is in front of it, seen through, and not there
  // from behind. They are drawn after the bodies that hide them and before what is seen through, and write no depth:
  // they tint what is behind them and nothing else.
  addHalfspace(shape, place, group) {
    const normal = new THREE.Vector3(...shape.sizes.slice(0, 3));
    const frame = new THREE.Matrix4(), middle = new THREE.Vector3(...this.view.center);
    const world = normal.clone().transformDirection(place), level = world.z > 0.9, slope = world.z > 0.5;
    middle.applyMatrix4(place.clone().invert());
    middle.addScaledVector(normal, shape.sizes[3] - normal.dot(middle));
    const across = new THREE.Vector3(0, 0, 1).cross(normal);
    if (across.length() < 1e-9) { across.set(1, 0, 0); }
    across.normalize();
    frame.makeBasis(across, normal.clone().cross(across), normal).setPosition(middle);
    const total = place.clone().multiply(frame);
    const [low, high] = level ? [[0, 0], [0, 0]] : this.shadowOn(total);
    const radius = this.view.radius, fade = level ? [2.2 * radius, 7 * radius] : [1e30, 2e30];
    const flat = level ? new THREE.CircleGeometry(7 * radius, 64)
      : new THREE.PlaneGeometry(high[0] - low[0], high[1] - low[1])
          .translate((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, 0);
    const opacity = level ? 1 : slope ? 0.9 : 0.4;
    const material = new THREE.MeshLambertMaterial({color: new THREE.Color(shape.color).convertSRGBToLinear(),
      transparent: true, opacity, depthWrite: false});
    material.onBeforeCompile = withGrid(roundNumber(radius / 2), fade);
    const mesh = new THREE.Mesh(flat, material);
    mesh.name = shape.name;
    mesh.renderOrder = level ? -2 : -1;
    mesh.receiveShadow = true;
    mesh.applyMatrix4(total);
    group.add(mesh);
    if (!level) {
      const edge = new THREE.LineSegments(new THREE.EdgesGeometry(flat),
        new THREE.LineBasicMaterial({color: GRID, transparent: true, opacity: 0.6}));
      edge.applyMatrix4(total);
      edge.userData.endless = true;
      group.add(edge);
    }
    mesh.userData.endless = true;
  }

  // Leave ground and walls out, or let only the shadows on them be seen.
  hideGround(shadows) {
    this.scene.traverse(part => {
      if (!part.userData.endless) { return; }
      part.visible = shadows && part.isMesh;
      if (part.visible) { part.material = new THREE.ShadowMaterial({opacity: 0.25, depthWrite: false}); }
    });
    this.draw();
  }

  // Corners in a plane's axes of what is in front of it, with a margin.
  shadowOn(frame) {
    const back = frame.clone().invert(), point = new THREE.Vector3(), margin = 0.15 * this.view.radius;
    const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
    for (const place of this.view.outline) {
      point.set(...place).applyMatrix4(back);
      [point.x, point.y].forEach((x, k) => { low[k] = Math.min(low[k], x); high[k] = Math.max(high[k], x); });
    }
    return [low.map(x => x - margin), high.map(x => x + margin)];
  }

  light() {
    const {center, radius, direction} = this.view;
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x9aa4b2, 0.55));
    this.camera.add(new THREE.DirectionalLight(0xffffff, 0.2));
    const sun = new THREE.DirectionalLight(0xffffff, 0.72);
    sun.target.position.set(...center);
    sun.castShadow = true;
    sun.shadow.mapSize.set(2048, 2048);
    sun.shadow.bias = -0.0004;
    sun.shadow.normalBias = radius / 200;
    sun.shadow.radius = 2.5;
    Object.assign(sun.shadow.camera, {left: -1.7 * radius, right: 1.7 * radius, bottom: -1.7 * radius,
      top: 1.7 * radius, near: 0.1 * radius, far: 12 * radius});
    this.scene.add(sun, sun.target);
    this.sun = sun;
    this.aim(...direction);
  }

  // Let the sun shine from above, on the right of a camera that stands in this direction.
  aim(x, y) {
    const {center, radius} = this.view, size = Math.hypot(x, y);
    if (size < 0.1) { return; }
    const along = [(0.5 * x - 0.6 * y) / size, (0.5 * y + 0.6 * x) / size, 1.25];
    this.sun.position.set(...center.map((c, k) => c + 3.5 * radius * along[k]));
  }

  // --- frames ---------------------------------------------------------------------------------------------------

  place(t) {
    this.bodies.forEach((group, k) => this.source.pose(k, t, group.position, group.quaternion));
    const z = new THREE.Vector3(0, 0, 1), along = new THREE.Vector3();
    for (const {shape, pieces, ends} of this.lines) {
      ends.forEach((end, k) => {
        const body = this.bodies[shape.bodies[k]];
        end.set(...shape.points[k]).applyQuaternion(body.quaternion).add(body.position);
      });
      pieces.forEach((piece, k) => {
        along.subVectors(ends[k + 1], ends[k]);
        const length = Math.max(along.length(), 1e-9);
        piece.position.copy(ends[k]);
        piece.scale.z = length;
        piece.quaternion.setFromUnitVectors(z, along.divideScalar(length));
      });
    }
    this.draw();
  }

  draw() { this.dirty = true; }

  render() {
    if (!this.dirty) { return; }
    this.dirty = false;
    if (this.beforeDraw) { this.beforeDraw(); }
    this.renderer.render(this.scene, this.camera);
    if (this.afterDraw) { this.afterDraw(); }
  }

  // Where the middle of a body's shapes is now.
  center(body, point) {
    const group = this.bodies[body];
    return point.copy(group.userData.center).applyQuaternion(group.quaternion).add(group.position);
  }
}

// --- geometries and materials -----------------------------------------------------------------------------------

function meshGeometry(shape) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(unpack(shape.vertices), 3));
  geometry.setAttribute("normal", new THREE.BufferAttribute(unpack(shape.normals), 3, true));
  geometry.setIndex(new THREE.BufferAttribute(unpack(shape.faces), 1));
  return geometry;
}

// Cylinders, cones and capsules have their axis along z.
function plainGeometry(kind, sizes, marked) {
  const [a, b, c] = sizes;
  switch (kind) {
    case "box": return new THREE.BoxGeometry(2 * a, 2 * b, 2 * c);
    case "sphere": return ball(marked).scale(a, a, a);
    case "ellipsoid": return ball(marked).scale(a, b, c);
    case "cylinder": return new THREE.CylinderGeometry(a, a, 2 * b, 48).rotateX(Math.PI / 2);
    case "cone": return new THREE.CylinderGeometry(0, a, 2 * b, 48).rotateX(Math.PI / 2);
    case "capsule": return capsule(a, b);
    default: throw new Error("unknown shape " + kind);
  }
}

// A unit ball; one that can turn has four darker octants, else its spin would not be seen.
function ball(marked) {
  const plain = new THREE.SphereGeometry(1, 40, 24);
  if (!marked) { return plain; }
  const geometry = plain.toNonIndexed(), at = geometry.getAttribute("position"), color = new Float32Array(3 * at.count);
  for (let k = 0; k < at.count; k += 3) {
    const middle = [0, 1, 2].map(axis => [k, k + 1, k + 2].reduce((sum, j) => sum + at.array[3 * j + axis], 0));
    color.fill(middle[0] * middle[1] * middle[2] > 0 ? 0.42 : 1, 3 * k, 3 * k + 9);
  }
  geometry.setAttribute("color", new THREE.BufferAttribute(color, 3));
  return geometry;
}

function capsule(radius, half) {
  const outline = [];
  for (let k = 0; k <= 24; ++k) {
    const turn = Math.PI * (k / 24 - 0.5), side = k < 12 ? -half : half;
    if (k === 12) { outline.push(new THREE.Vector2(radius, -half)); }
    outline.push(new THREE.Vector2(Math.max(radius * Math.cos(turn), 0), side + radius * Math.sin(turn)));
  }
  return new THREE.LatheGeometry(outline, 40).rotateX(Math.PI / 2);
}

// Surfaces turn darker where they are seen at a grazing angle: white is seen on white, and black has a shape.
function withOutline(shader) {
  shader.fragmentShader = shader.fragmentShader.replace("#include <tonemapping_fragment>",
    `float facing = abs(dot(normal, geometry.viewDir));
     float rim = 1.0 - smoothstep(0.0, 0.5, facing);
     float tone = dot(gl_FragColor.rgb, vec3(0.3, 0.6, 0.1));
     gl_FragColor.rgb = mix(gl_FragColor.rgb, gl_FragColor.rgb * (tone > 0.12 ? 0.35 : 1.9), 0.8 * rim * rim);
     #include <tonemapping_fragment>`);
}

// Lines of a grid, as sharp near as far, and a fading edge.
function withGrid(cell, [from, to]) {
  const line = new THREE.Color(GRID).convertSRGBToLinear().toArray().map(x => x.toFixed(4)).join();
  return shader => {
    shader.extensions = {derivatives: true};
    shader.vertexShader = "varying vec2 vPlace;\n" + shader.vertexShader.replace("#include <begin_vertex>",
      "#include <begin_vertex>\nvPlace = position.xy;");
    shader.fragmentShader = "varying vec2 vPlace;\n" + shader.fragmentShader.replace("#include <tonemapping_fragment>",
      `vec2 cells = vPlace / ${cell.toExponential(6)}, wide = fwidth(cells);
       vec2 near = abs(fract(cells - 0.5) - 0.5) / max(wide, vec2(1e-6));
       float line = (1.0 - min(min(near.x, near.y), 1.0)) * (1.0 - smoothstep(0.1, 0.6, max(wide.x, wide.y)));
       gl_FragColor.rgb = mix(gl_FragColor.rgb, vec3(${line}), 0.55 * line);
       gl_FragColor.a *= 1.0 - smoothstep(${from.toExponential(6)}, ${to.toExponential(6)}, length(vPlace));
       #include <tonemapping_fragment>`);
  };
}

// The largest of 1, 2, 5 times a power of ten that is not above a value.
function roundNumber(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].find(step => step * power <= value * (1 + 1e-12)) * power;
}

// The ball around the shapes of a body, in its own frame.
function measure(group) {
  const box = new THREE.Box3(), own = new THREE.Box3();
  for (const mesh of group.children) {
    if (!mesh.isMesh || mesh.userData.endless) { continue; }
    mesh.geometry.computeBoundingBox();
    mesh.updateMatrix();
    box.union(own.copy(mesh.geometry.boundingBox).applyMatrix4(mesh.matrix));
  }
  if (box.isEmpty()) { return; }
  box.getCenter(group.userData.center);
  group.userData.radius = 0.5 * box.getSize(new THREE.Vector3()).length();
}
