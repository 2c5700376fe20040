"""Integrals of an environment over the two zonal kernels of the skin model.

An environment is a tree of rectangular patches of the sphere (``PatchTree``), each with the zeroth
and first moment of its radiance. Both kernels are linear in N.L on either side of their one kink
(N.L = 0, N.L = -l), so a patch that no kink crosses contributes exactly through its moments, and
only the few patches under a kink are refined. A patch that cannot be refined further is integrated
in closed form as a uniform rectangle.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class PatchTree:
    """A quadtree of environment patches in depth-first order, r channels in groups of four."""

    center: wp.array[wp.vec3f]
    """Direction of the patch's centroid, in world space, shape [node_count]."""

    radius: wp.array[wp.float32]
    """Largest chord from ``center`` to a point of the patch, shape [node_count]."""

    skip: wp.array[wp.int32]
    """The next node that is not below this one; a leaf skips to the next, shape [node_count]."""

    half_azimuth: wp.array[wp.vec3f]
    """Half the extent of a leaf along the azimuth, a tangent vector, shape [node_count]."""

    half_elevation: wp.array[wp.vec3f]
    """Half the extent of a leaf along the elevation, a tangent vector, shape [node_count]."""

    flux: wp.array2d[wp.vec4f]
    """Int c dL, coefficients times solid angle [sr], shape [group_count, node_count]."""

    flux_x: wp.array2d[wp.vec4f]
    """Int c L_x dL [sr], shape [group_count, node_count]."""

    flux_y: wp.array2d[wp.vec4f]
    """Int c L_y dL [sr], shape [group_count, node_count]."""

    flux_z: wp.array2d[wp.vec4f]
    """Int c L_z dL [sr], shape [group_count, node_count]."""


@wp.func
def _cube(y: wp.float32) -> wp.float32:
    positive = wp.max(y, 0.0)
    return positive * positive * positive


@wp.func
def _square(y: wp.float32) -> wp.float32:
    positive = wp.max(y, 0.0)
    return positive * positive


@wp.func
def mean_ramp(x: wp.float32, a: wp.float32, b: wp.float32) -> wp.float32:
    """Return the mean of max(x + a s + b t, 0) over s, t uniform in [-1, 1].

    The closed form is the mixed second difference of the ramp's second antiderivative.
    """
    wide = wp.max(wp.abs(a), wp.abs(b))
    narrow = wp.min(wp.abs(a), wp.abs(b))
    if x >= wide + narrow:
        return x
    if x <= -(wide + narrow):
        return 0.0
    if narrow < 1.0e-3 * wide:
        reach = wp.clamp(x + wide, 0.0, 2.0 * wide)
        return reach * reach / (4.0 * wide) + wp.max(x - wide, 0.0)
    total = (
        _cube(x + wide + narrow)
        - _cube(x + wide - narrow)
        - _cube(x - wide + narrow)
        + _cube(x - wide - narrow)
    )
    return total / (24.0 * wide * narrow)


@wp.func
def mean_step(x: wp.float32, a: wp.float32, b: wp.float32) -> wp.float32:
    """Return the share of s, t uniform in [-1, 1] with x + a s + b t > 0."""
    wide = wp.max(wp.abs(a), wp.abs(b))
    narrow = wp.min(wp.abs(a), wp.abs(b))
    if x >= wide + narrow:
        return 1.0
    if x <= -(wide + narrow):
        return 0.0
    if narrow < 1.0e-3 * wide:
        return wp.clamp((x + wide) / (2.0 * wide), 0.0, 1.0)
    total = (
        _square(x + wide + narrow)
        - _square(x + wide - narrow)
        - _square(x - wide + narrow)
        + _square(x - wide - narrow)
    )
    return total / (8.0 * wide * narrow)


@wp.kernel(enable_backward=False)
def _integrate_zonal_kernel(
    # In:
    tree: PatchTree,
    normal: wp.array[wp.vec3f],
    wrap: wp.float32,
    offset: wp.int32,
    # Out:
    lambert_out: wp.array2d[wp.vec4f],
    wrap_out: wp.array2d[wp.vec4f],
    front_out: wp.array2d[wp.vec4f],
):
    """Integrate the environment over both kernels at one normal.

    J1 = Int max(N.L, 0) c dL, J2 = Int max((N.L + l)/(1 + l), 0) c dL, and the hemisphere integral
    H = Int_{N.L > 0} c dL, from which the front part of J2 follows as (J1 + l H)/(1 + l).

    Launch dimension: [normal_count, group_count], from ``offset``.

    Args:
        tree: The environment.
        normal: Unit normals in world space, shape [normal_count].
        wrap: l in [0, 1].
        offset: First normal of this launch.
        lambert_out: J1 [coefficient sr], shape [group_count, normal_count].
        wrap_out: J2 [coefficient sr], shape [group_count, normal_count].
        front_out: H [coefficient sr], shape [group_count, normal_count].
    """
    i, group = wp.tid()
    index = offset + i
    n = normal[index]
    lambert = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    wrapped = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    front = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    scale = 1.0 / (1.0 + wrap)
    node = int(0)
    count = tree.center.shape[0]
    while node < count:
        x = wp.dot(n, tree.center[node])
        radius = tree.radius[node]
        crossed = wp.abs(x) < radius or wp.abs(x + wrap) < radius
        following = tree.skip[node]
        if not crossed:
            if x > -wrap:
                flux = tree.flux[group, node]
                ramp = (
                    n[0] * tree.flux_x[group, node]
                    + n[1] * tree.flux_y[group, node]
                    + n[2] * tree.flux_z[group, node]
                )
                wrapped += scale * (ramp + wrap * flux)
                if x > 0.0:
                    lambert += ramp
                    front += flux
            node = following
        elif following == node + 1:
            flux = tree.flux[group, node]
            a = wp.dot(n, tree.half_azimuth[node])
            b = wp.dot(n, tree.half_elevation[node])
            lambert += mean_ramp(x, a, b) * flux
            wrapped += scale * mean_ramp(x + wrap, a, b) * flux
            front += mean_step(x, a, b) * flux
            node = following
        else:
            node = node + 1
    lambert_out[group, index] = lambert
    wrap_out[group, index] = wrapped
    front_out[group, index] = front


def integrate_zonal(
    tree: PatchTree,
    normal: wp.array[wp.vec3f],
    wrap: float,
    out: tuple[wp.array2d[wp.vec4f], wp.array2d[wp.vec4f], wp.array2d[wp.vec4f]],
    begin: int,
    end: int,
) -> None:
    """Write J1, J2 and H of normals ``begin`` to ``end`` into ``out``.

    Args:
        tree: The environment; its arrays are on the device of ``normal``.
        normal: Unit normals in world space, shape [normal_count].
        wrap: l in [0, 1].
        out: J1, J2, H, each of shape [group_count, normal_count].
        begin: First normal.
        end: One past the last normal.
    """
    wp.launch(
        _integrate_zonal_kernel,
        dim=(end - begin, out[0].shape[0]),
        inputs=[tree, normal, wrap, begin],
        outputs=list(out),
        device=normal.device,
    )
