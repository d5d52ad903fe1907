// Materials that cost little: light by the vertex, colours as they stand in the style sheet. Without a graphics processor
// that is what decides how many frames a second there are.

import { Color, type DataTexture, ShaderMaterial } from 'three';

const SOLID = {
  vertexShader: `
    uniform vec3 tone;
    varying vec3 seen;
    void main() {
      vec3 n = normalize(mat3(modelMatrix) * (normal / vec3(dot(modelMatrix[0].xyz, modelMatrix[0].xyz), dot(modelMatrix[1].xyz, modelMatrix[1].xyz), dot(modelMatrix[2].xyz, modelMatrix[2].xyz))));
      float sun = max(dot(n, vec3(-0.41, 0.35, 0.84)), 0.0);
      seen = tone * (0.70 + 0.08 * n.z + 0.32 * sun);
      gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
    }`,
  fragmentShader: `
    uniform float opacity;
    varying vec3 seen;
    void main() { gl_FragColor = vec4(seen, opacity); }`,
};

const DRAPED = {
  vertexShader: `
    varying vec2 at;
    void main() {
      at = uv;
      gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
    }`,
  fragmentShader: `
    uniform sampler2D map;
    varying vec2 at;
    void main() { gl_FragColor = texture2D(map, at); }`,
};

export function solid(r: number, g: number, b: number, opacity: number, ghost: boolean): ShaderMaterial {
  const tone = new Color().setRGB(r, g, b);
  return new ShaderMaterial({ ...SOLID, uniforms: { tone: { value: tone }, opacity: { value: opacity } }, transparent: opacity < 1, depthWrite: !ghost, polygonOffset: ghost, polygonOffsetFactor: 1, polygonOffsetUnits: 4 });
}

export function draped(): ShaderMaterial & { uniforms: { map: { value: DataTexture | null } } } {
  return new ShaderMaterial({ ...DRAPED, uniforms: { map: { value: null } } }) as ReturnType<typeof draped>;
}
