// Smooth edges for a processor without graphics. It takes two thirds of its time to draw four samples of each pixel; here it
// draws one, and each pixel at an edge is then mixed with those along the edge (after FXAA, Lottes 2009).

class Smoother {
  constructor(renderer, width, height) {
    this.renderer = renderer;
    this.rough = new THREE.WebGLRenderTarget(width, height, {stencilBuffer: true});  // for a depth of 24 bits
    this.rough.texture.encoding = THREE.sRGBEncoding;
    this.smooth = new THREE.WebGLRenderTarget(width, height, {depthBuffer: false});
    const material = new THREE.ShaderMaterial({depthTest: false, depthWrite: false, vertexShader: CORNERS,
      fragmentShader: EDGES, uniforms: {picture: {value: this.rough.texture},
        pixel: {value: new THREE.Vector2(1 / width, 1 / height)}}});
    const sheet = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), material);
    sheet.frustumCulled = false;
    this.scene = new THREE.Scene().add(sheet);
    this.camera = new THREE.Camera();
  }

  // Let `render` draw, and return the framebuffer that has the smooth picture.
  draw(render) {
    const {renderer} = this;
    renderer.setRenderTarget(this.rough);
    render();
    renderer.setRenderTarget(this.smooth);
    renderer.render(this.scene, this.camera);
    renderer.setRenderTarget(null);
    return renderer.properties.get(this.smooth).__webglFramebuffer;
  }
}

// Whether a processor draws, and no graphics card.
function isSoftware(gl) {
  const told = gl.getExtension("WEBGL_debug_renderer_info");
  return Boolean(told) && /llvmpipe|softpipe|swiftshader|software/i.test(gl.getParameter(told.UNMASKED_RENDERER_WEBGL));
}

const CORNERS = "varying vec2 at; void main() { at = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }";
const EDGES = `
  uniform sampler2D picture;
  uniform vec2 pixel;
  varying vec2 at;
  vec3 color(vec2 off) { return texture2D(picture, at + off * pixel).rgb; }
  float light(vec3 color) { return dot(color, vec3(0.3, 0.6, 0.1)); }
  void main() {
    vec3 own = color(vec2(0.0)), a = color(vec2(-1.0, 1.0)), b = color(vec2(1.0, 1.0)),
      c = color(vec2(-1.0, -1.0)), d = color(vec2(1.0, -1.0));
    float here = light(own), la = light(a), lb = light(b), lc = light(c), ld = light(d);
    float low = min(here, min(min(la, lb), min(lc, ld))), high = max(here, max(max(la, lb), max(lc, ld)));
    gl_FragColor = vec4(own, 1.0);
    if (high - low < max(0.03, 0.08 * high)) { return; }
    vec2 along = vec2(lc + ld - la - lb, la + lc - lb - ld);  // across the steepest rise of the light
    along /= min(abs(along.x), abs(along.y)) + max(0.03 * (la + lb + lc + ld), 0.008);
    along = clamp(along, -8.0, 8.0);
    vec3 near = 0.5 * (color(along / 6.0) + color(-along / 6.0));
    vec3 wide = 0.5 * near + 0.25 * (color(0.5 * along) + color(-0.5 * along));
    vec3 mixed = light(wide) < low || light(wide) > high ? near : wide;
    vec3 mean = 0.25 * (a + b + c + d);
    float alone = clamp(2.0 * abs(light(mean) - here) / (high - low) - 0.5, 0.0, 1.0);  // a speck
    gl_FragColor.rgb = mix(mixed, 0.5 * (mean + mixed), alone);
  }`;
