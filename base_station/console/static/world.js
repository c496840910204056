// A map as one object of NiceGUI's 3-D scene: its points, the keyframes as dots on a path, the camera as a frustum, and
// a grid at the height where the camera moves. The grid is of lines only: an opaque ground would hide what lies below.

import { THREE } from "nicegui-scene";

const POINT = "#b9c4cf", KEYFRAME = "#f2992e", CAMERA = "#4a9dff", GRID = "#3a4651";
const POINT_PX = 2, KEYFRAME_PX = 6;
const GRID_SIDE = 8, GRID_CELLS = 8; // in the scene's unit, as the next
const FRUSTUM = [0.36, 0.27, 0.6]; // half a picture's width and height, and how far it is from the camera's center

export default class World {
  create_mesh(...told) {
    this.mesh = new THREE.Group();
    this.mesh.rotation.x = -Math.PI / 2; // from the map's axes (x right, y down, z ahead) to the scene's (z up)
    this.map = new THREE.Group();
    this.grid = new THREE.GridHelper(GRID_SIDE, GRID_CELLS, GRID, GRID);
    this.points = cloud(POINT, POINT_PX);
    this.path = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: KEYFRAME }));
    this.keyframes = cloud(KEYFRAME, KEYFRAME_PX);
    this.camera = frustum();
    this.map.add(this.points, this.path, this.keyframes, this.camera);
    this.mesh.add(this.grid, this.map);
    [this.grid, this.points, this.path, this.keyframes, this.camera].forEach(inFront);
    for (const name of ["points", "keyframes", "camera"]) this[name].name = name; // for who looks into the scene
    if (told.length) this.show(...told);
    return this.mesh;
  }

  // `points`, `keyframes`: float32 x, y, z as base64, null where they have not changed; `camera`: 4x4, row by row, null
  // while its place is not known; `fit`: what is the middle, and how long a unit of the map is in the scene; `height`:
  // of the grid, as the map's y.
  show(points, keyframes, camera, { middle, scale }, height) {
    this.map.scale.setScalar(scale);
    this.map.position.set(...middle).multiplyScalar(-scale);
    this.grid.position.y = (height - middle[1]) * scale;
    if (points !== null) place(numbers(points), this.points);
    if (keyframes !== null) place(numbers(keyframes), this.path, this.keyframes);
    this.camera.visible = camera !== null;
    if (camera === null) return;
    const pose = new THREE.Matrix4().set(...camera);
    this.camera.position.setFromMatrixPosition(pose);
    this.camera.quaternion.setFromRotationMatrix(pose);
    this.camera.scale.setScalar(1 / scale);
  }
}

function cloud(color, size) {
  return new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ color, size, sizeAttenuation: false }));
}

function frustum() {
  const [x, y, z] = FRUSTUM;
  const corners = [[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]];
  const next = (i) => corners[(i + 1) % 4];
  const edges = corners.flatMap((corner, i) => [[0, 0, 0], corner, corner, next(i)]);
  const faces = corners.flatMap((corner, i) => [[0, 0, 0], corner, next(i)]);
  const shape = (rows) => new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(rows.flat(), 3));
  const glass = { color: CAMERA, opacity: 0.3, transparent: true, side: THREE.DoubleSide };
  const made = new THREE.Group();
  made.add(new THREE.Mesh(shape(faces), new THREE.MeshBasicMaterial(glass)));
  made.add(new THREE.LineSegments(shape(edges), new THREE.LineBasicMaterial({ color: CAMERA })));
  return made;
}

// Whatever is added later lies in front; and nothing is left out as out of view, which is judged by where its points once were.
function inFront(part, order) {
  part.traverse((one) => {
    one.frustumCulled = false;
    one.renderOrder = order;
    if (one.material) Object.assign(one.material, { depthTest: false, transparent: true });
  });
}

function place(rows, ...parts) {
  parts[0].geometry.dispose(); // or the buffers of each map that came would stay
  const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(rows, 3));
  for (const part of parts) part.geometry = geometry;
}

function numbers(text) {
  return new Float32Array(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}
