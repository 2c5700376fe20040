"""Small stages whose shadows are known: for the tests of baked transfer."""

import numpy as np
import OpenEXR

HEADER = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
    subLayers = [{layers}]
)
"""

WORLD = """
def Xform "World"
{{
    def Camera "Camera"
    {{
        float2 clippingRange = (0.01, 100)
        float focalLength = 2
        float horizontalAperture = 1
        float verticalAperture = 1
        matrix4d xformOp:transform = (
            (1, 0, 0, 0), (0, 0.6, -0.8, 0), (0, 0.8, 0.6, 0), (0, 3.2, 2.4, 1)
        )
        uniform token[] xformOpOrder = ["xformOp:transform"]
    }}
    def DomeLight "Dome" (prepend apiSchemas = ["SpectralLightAPI"])
    {{
        {dome}
        float3 xformOp:rotateXYZ = (0, {turn}, 0)
        uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
    }}
    def Material "Skin" (
        prepend apiSchemas = ["SkinMaterialAPI", "SpectralDistributionAPI:scattering"]
    )
    {{
        float inputs:skin:alpha = 0.7
        float inputs:skin:wrap = {wrap}
        float inputs:skin:opacity = {opacity}
        float inputs:skin:specular:weight = {gloss}
        uniform double[] spectrum:scattering:wavelengths = [400, 700]
        double[] spectrum:scattering:values = [0.3, 0.3]
        uniform token spectrum:scattering:quantity = "scattering"
    }}
{meshes}
}}
"""

UNIFORM = 'uniform token inputs:spectral:source = "rgb"'


def mesh(name, points, faces, material="Skin"):
    """Return a polygon mesh of quads or triangles, in the stage's text."""
    binding, api = "", ""
    if material:
        binding = f"rel material:binding = </World/{material}>"
        api = '(prepend apiSchemas = ["MaterialBindingAPI"])'
    counts = [len(face) for face in faces]
    corners = [int(corner) for face in faces for corner in face]
    positions = ", ".join(f"({x:.9g}, {y:.9g}, {z:.9g})" for x, y, z in points)
    return f"""
    def Mesh "{name}" {api}
    {{
        {binding}
        uniform token subdivisionScheme = "none"
        int[] faceVertexCounts = {counts}
        int[] faceVertexIndices = {corners}
        point3f[] points = [{positions}]
    }}
"""


def grid(size, steps, height=0.0):
    """Return points and quads of a square, facing +Y."""
    axis = np.linspace(-size / 2, size / 2, steps + 1)
    x, z = np.meshgrid(axis, axis)
    points = np.stack([x.ravel(), np.full(x.size, height), z.ravel()], axis=-1)
    first = (np.arange(steps)[:, None] * (steps + 1) + np.arange(steps)).ravel()
    faces = np.stack([first, first + steps + 1, first + steps + 2, first + 1], axis=-1)
    return points, faces


def disc(radius, height, sides=96):
    """Return a fan of triangles, facing down."""
    turn = 2 * np.pi * np.arange(sides) / sides
    rim = np.stack([radius * np.cos(turn), np.full(sides, height), radius * np.sin(turn)], axis=-1)
    points = np.concatenate([rim, [[0.0, height, 0.0]]])
    faces = [(sides, k, (k + 1) % sides) for k in range(sides)]
    return points, faces


def ball(radius, center, rings=24):
    """Return a closed ball of triangles and quads."""
    polar = np.pi * np.arange(1, rings) / rings
    turn = 2 * np.pi * np.arange(2 * rings) / (2 * rings)
    p, t = np.meshgrid(polar, turn, indexing="ij")
    body = np.stack([np.sin(p) * np.cos(t), np.cos(p), -np.sin(p) * np.sin(t)], axis=-1)
    points = np.concatenate([[[0, 1.0, 0]], body.reshape(-1, 3), [[0, -1.0, 0]]])
    wide, faces = 2 * rings, []
    for j in range(wide):
        k = (j + 1) % wide
        faces.append((0, 1 + j, 1 + k))
        faces.append((len(points) - 1, 1 + (rings - 2) * wide + k, 1 + (rings - 2) * wide + j))
        for i in range(rings - 2):
            a = 1 + i * wide
            faces.append((a + j, a + wide + j, a + wide + k, a + k))
    return radius * points + np.asarray(center), faces


def box(sizes, steps=4):
    """Return a closed box around the origin, its top and bottom cut into squares."""
    sx, sy, sz = sizes
    top, quads = grid(1.0, steps)
    scale = np.array([sx, 1.0, sz])
    up, down = top * scale + [0, sy / 2, 0], top * scale - [0, sy / 2, 0]
    faces = [*quads.tolist(), *(quads[:, ::-1] + len(top)).tolist()]
    n, count = steps + 1, len(top)
    edge = [*range(n), *range(2 * n - 1, n * n, n), *range(n * n - 2, n * n - n - 1, -1)]
    edge += list(range(n * n - 2 * n, 0, -n))
    for a, b in zip(edge, edge[1:] + edge[:1], strict=True):
        faces.append((a, b, b + count, a + count))
    return np.concatenate([up, down]), faces


def write_stage(
    path, *meshes, layers=(), dome=UNIFORM, turn=0.0, wrap=0.3, opacity=0.0, gloss=0.0, extra=""
):
    """Write a stage of meshes under a dome; return its path."""
    names = ", ".join(f"@./{layer}@" for layer in layers)
    text = HEADER.format(layers=names) + WORLD.format(
        dome=dome,
        turn=turn,
        wrap=wrap,
        opacity=opacity,
        gloss=gloss,
        meshes="".join(meshes) + extra,
    )
    path.write_text(text)
    return path


def window_dome(path, lamp=True):
    """Write a dim room with a window, and a sharp lamp; return the dome's opinions."""
    image = np.full((64, 128, 3), 0.2, np.float32)
    image[14:26, 8:30] = (3.0, 3.2, 4.0)
    image[40:] *= 0.5
    if lamp:
        image[12:13, 80:82] = 160.0
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": image}).write(str(path))
    return f"{UNIFORM}\n        asset inputs:texture:file = @./{path.name}@"
