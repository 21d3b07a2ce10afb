"""Rings as solids for printers, CAD and browsers: 3MF and GLB have one torus for each size of rings and place it many
times, STL has the surfaces of all.

Own writers, each a few lines of text: trimesh wants lxml and networkx for 3MF, repeats the torus for every place there
and writes single parts, which slicers would lay out one by one.
"""

import json
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
from scipy.spatial.transform import Rotation

from rve.common import Array, Index, atomic_path
from rve.geometry.ring_pair import tangent_frame
from rve.placed.drawn import DrawnRings

SOLID_ENDINGS = (".3mf", ".glb", ".stl")
FACETS = 48, 16
"""Along and around the wire: facets are within 0.22 % of r1 and 2 % of r2 of the torus."""
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_METAL = {"baseColorFactor": [0.75, 0.76, 0.78, 1.0], "metallicFactor": 0.2, "roughnessFactor": 0.4}
_FLOAT, _INDEX = 5126, 5125

Shape = tuple[Array, Index, Array, Array]
"""Points (p, 3) of a torus about the z axis, its triangles (t, 3), and where it stands: turns (n, 3, 3), whose columns
are its axes, and centres (n, 3), all in mm."""


def write_solids(path: Path, rings: DrawnRings) -> None:
    """Write rings as solids, closed surfaces of triangles whose normals point outwards, atomically; the ending of the
    name says in which format. 3MF and STL are in mm, GLB in m, its y axis up."""
    with atomic_path(path) as temporary:
        {".3mf": _write_3mf, ".glb": _write_glb, ".stl": _write_stl}[path.suffix.lower()](temporary, rings)


def _shapes(rings: DrawnRings) -> list[Shape]:
    """Each size of rings once, with its places."""
    count = len(rings.centre)
    sizes = np.stack([np.broadcast_to(size, count) for size in (rings.r1, rings.r2)], axis=1)
    each, kind = np.unique(sizes, axis=0, return_inverse=True)
    turn = np.stack([*tangent_frame(rings.normal), rings.normal], axis=2)
    shapes = []
    for k, (r1, r2) in enumerate(each):
        points, triangles = _triangles(DrawnRings(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), r1, r2))
        shapes.append((points, triangles, turn[kind.ravel() == k], rings.centre[kind.ravel() == k]))
    return shapes


def _triangles(rings: DrawnRings) -> tuple[Array, Index]:
    """Points (p, 3) and triangles (t, 3) of tori."""
    points, quads = rings.tubes(*FACETS)
    return points, quads[..., [0, 1, 2, 0, 2, 3]].reshape(-1, 3)


def _write_stl(path: Path, rings: DrawnRings) -> None:
    import meshio

    points, triangles = _triangles(rings)
    meshio.write(path, meshio.Mesh(points, [("triangle", triangles)]), file_format="stl", binary=True)


def _write_3mf(path: Path, rings: DrawnRings) -> None:
    """One object whose components are the places: slicers keep them together as one part."""
    objects, places = [], []
    for number, (points, triangles, turn, centre) in enumerate(_shapes(rings), 1):
        corners = "".join(f'<vertex x="{x:.7g}" y="{y:.7g}" z="{z:.7g}"/>' for x, y, z in points)
        faces = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in triangles)
        mesh = f"<mesh><vertices>{corners}</vertices><triangles>{faces}</triangles></mesh>"
        objects.append(f'<object id="{number}" type="model">{mesh}</object>')
        for rows in np.concatenate([turn.transpose(0, 2, 1), centre[:, None]], axis=1).reshape(-1, 12):
            numbers = " ".join(f"{x:.9g}" for x in rows)  # images of the axes, then the origin's
            places.append(f'<component objectid="{number}" transform="{numbers}"/>')
    whole = len(objects) + 1
    objects.append(f'<object id="{whole}" type="model"><components>{"".join(places)}</components></object>')
    head = '<?xml version="1.0" encoding="UTF-8"?>\n'
    model, kind = "3D/3dmodel.model", "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    texts = {
        "[Content_Types].xml": f'<Types xmlns="{_PACKAGE}/content-types">'
        f'<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
        f'<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>',
        "_rels/.rels": f'<Relationships xmlns="{_PACKAGE}/relationships">'
        f'<Relationship Id="rel0" Target="/{model}" Type="{kind}"/></Relationships>',
        model: f'<model unit="millimeter" xml:lang="en-US" xmlns="{_CORE}"><resources>{"".join(objects)}</resources>'
        f'<build><item objectid="{whole}"/></build></model>',
    }
    with ZipFile(path, "w", ZIP_DEFLATED) as file:
        for name, text in texts.items():
            file.writestr(name, head + text)


def _write_glb(path: Path, rings: DrawnRings) -> None:
    """Nodes that share a mesh, which every reader knows, below one that makes metres of mm."""
    data, views, accessors, meshes, nodes = b"", list[object](), list[object](), list[object](), list[object]()
    for number, (points, triangles, turn, centre) in enumerate(_shapes(rings)):
        line = np.repeat(points.reshape(-1, FACETS[1], 3).mean(axis=1), FACETS[1], axis=0)
        out = (points - line) / np.linalg.norm(points - line, axis=1, keepdims=True)
        for array, kind in ((points, _FLOAT), (out, _FLOAT), (triangles.reshape(-1, 1), _INDEX)):
            numbers = array.astype("<f4" if kind == _FLOAT else "<u4")
            views.append({"buffer": 0, "byteOffset": len(data), "byteLength": numbers.nbytes})
            accessor = {"bufferView": len(views) - 1, "componentType": kind, "count": len(array)}
            ends = {"min": numbers.min(axis=0).tolist(), "max": numbers.max(axis=0).tolist()}
            accessors.append(accessor | {"type": "SCALAR" if kind == _INDEX else "VEC3"} | ends)
            data += numbers.tobytes()
        first = len(views) - 3
        surface = {"attributes": {"POSITION": first, "NORMAL": first + 1}, "indices": first + 2, "material": 0}
        meshes.append({"primitives": [surface]})
        turns = Rotation.from_matrix(turn).as_quat() if len(turn) else np.zeros((0, 4))
        for q, x in zip(turns.tolist(), centre.tolist(), strict=True):
            nodes.append({"mesh": number, "rotation": q, "translation": x})
    whole = {"name": "rings", "scale": [1e-3, 1e-3, 1e-3], "children": list(range(len(nodes)))}
    record = {"asset": {"version": "2.0", "generator": "ring-mesh"}, "scene": 0, "scenes": [{"nodes": [len(nodes)]}]}
    record |= {"nodes": [*nodes, whole], "meshes": meshes, "materials": [{"pbrMetallicRoughness": _METAL}]}
    record |= {"buffers": [{"byteLength": len(data)}], "bufferViews": views, "accessors": accessors}
    text = json.dumps(record, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = (b"glTF", 2, 28 + len(text) + len(data))
    with path.open("wb") as file:
        file.write(head[0] + np.array(head[1:], "<u4").tobytes())
        file.write(np.array([len(text)], "<u4").tobytes() + b"JSON" + text)
        file.write(np.array([len(data)], "<u4").tobytes() + b"BIN\0" + data)
