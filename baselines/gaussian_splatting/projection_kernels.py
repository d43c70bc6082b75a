"""Gaussians to splats: projection, colour by direction, and the way back of all gradients.

Compiled with numba for float32 and float64; `rasterizer_reference` holds the readable twin. A
splat is a row of numbers (the constants below), its values are red, green, blue, depth and any
extra channels. Elliptical weighted averaging (Zwicker et al. 2001): with ``U = J W R S``, two rows
in pixels, the covariance on the picture is ``U U^T`` plus a low-pass filter.

All literals are made of the arrays' own type: a float64 literal, or an integer beside a float32,
would turn the whole computation to float64. One file, because numba's cache does not notice a
change in a function that comes from another.
"""

import math
from typing import Any

import numpy as np
from numba import njit

X, Y, A, B, C, OPACITY, CUT, HALF_WIDTH, HALF_HEIGHT = range(9)
"""Columns of a splat: centre in pixels; inverse covariance ``[[A, B], [B, C]]``; opacity; the
exponent at which alpha falls to `MIN_ALPHA`; half the size of the box outside which it is less.
A splat with half width 0 is not in sight."""
SPLAT = 9

MOMENTS = 6
"""Leading columns of a splat's gradient: sums over pixels of the exponent's gradient ``e`` times
1, dx, dy, dx dx, dx dy, dy dy; the values' gradients follow."""

LOW_PASS = 0.3
"""Added to the variance of a splat, in square pixels."""
MIN_ALPHA = 1 / 255
_SLACK = 0.01  # pixels by which boxes are too large, so that rounding loses no pixel

_FLAGS: dict[str, Any] = {
    "cache": True, "error_model": "numpy", "fastmath": {"reassoc", "contract", "arcp", "nsz"},
}  # fmt: skip
_INLINE: dict[str, Any] = {**_FLAGS, "forceinline": True}
_THREAD: dict[str, Any] = {**_FLAGS, "nogil": True}


@njit(**_INLINE)
def _rotation(q, one, two):
    """Rotation matrix (row by row) of a quaternion, the unit quaternion and its length."""
    length = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    w, x, y, z = q[0] / length, q[1] / length, q[2] / length, q[3] / length
    matrix = (
        one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y),
        two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x),
        two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y),
    )  # fmt: skip
    return matrix, (w, x, y, z), length


@njit(**_INLINE)
def _in_camera(mean, cam):
    """The centre in the camera's frame."""
    x = cam[0] * mean[0] + cam[1] * mean[1] + cam[2] * mean[2] + cam[9]
    y = cam[3] * mean[0] + cam[4] * mean[1] + cam[5] * mean[2] + cam[10]
    z = cam[6] * mean[0] + cam[7] * mean[1] + cam[8] * mean[2] + cam[11]
    return x, y, z


@njit(**_INLINE)
def _axes_on_picture(turn, scales, cam, u, v, z):
    """`V`, the axes in the camera's frame, and `U`, in pixels, as 9 and 6 numbers."""
    s0, s1, s2 = scales
    m = (
        turn[0] * s0, turn[1] * s1, turn[2] * s2,
        turn[3] * s0, turn[4] * s1, turn[5] * s2,
        turn[6] * s0, turn[7] * s1, turn[8] * s2,
    )  # fmt: skip
    V = (
        cam[0] * m[0] + cam[1] * m[3] + cam[2] * m[6],
        cam[0] * m[1] + cam[1] * m[4] + cam[2] * m[7],
        cam[0] * m[2] + cam[1] * m[5] + cam[2] * m[8],
        cam[3] * m[0] + cam[4] * m[3] + cam[5] * m[6],
        cam[3] * m[1] + cam[4] * m[4] + cam[5] * m[7],
        cam[3] * m[2] + cam[4] * m[5] + cam[5] * m[8],
        cam[6] * m[0] + cam[7] * m[3] + cam[8] * m[6],
        cam[6] * m[1] + cam[7] * m[4] + cam[8] * m[7],
        cam[6] * m[2] + cam[7] * m[5] + cam[8] * m[8],
    )
    a0, a1, a2 = (V[0] - u * V[6]) / z, (V[1] - u * V[7]) / z, (V[2] - u * V[8]) / z
    b0, b1, b2 = (V[3] - v * V[6]) / z, (V[4] - v * V[7]) / z, (V[5] - v * V[8]) / z
    fx, fy, skew = cam[12], cam[13], cam[14]
    U = (
        fx * a0 + skew * b0, fx * a1 + skew * b1, fx * a2 + skew * b2, fy * b0, fy * b1, fy * b2,
    )  # fmt: skip
    return V, (a0, a1, a2, b0, b1, b2), U


@njit(**_INLINE)
def _harmonics(degree, x, y, z, basis):
    """Fill `basis` (16, 4): the real spherical harmonics at a unit vector, and their gradient."""
    r = basis.dtype.type
    o = r(0)
    basis[:] = o
    basis[0, 0] = r(0.28209479177387814)
    if degree > 0:
        k = r(0.4886025119029199)
        basis[1, 0], basis[1, 2] = -k * y, -k
        basis[2, 0], basis[2, 3] = k * z, k
        basis[3, 0], basis[3, 1] = -k * x, -k
    if degree > 1:
        k, m, h = r(1.0925484305920792), r(0.31539156525252005), r(0.5462742152960396)
        two = r(2)
        basis[4, 0], basis[4, 1], basis[4, 2] = k * x * y, k * y, k * x
        basis[5, 0], basis[5, 2], basis[5, 3] = -k * y * z, -k * z, -k * y
        basis[6, 0] = m * (two * z * z - x * x - y * y)
        basis[6, 1], basis[6, 2], basis[6, 3] = -two * m * x, -two * m * y, r(4) * m * z
        basis[7, 0], basis[7, 1], basis[7, 3] = -k * x * z, -k * z, -k * x
        basis[8, 0], basis[8, 1], basis[8, 2] = h * (x * x - y * y), two * h * x, -two * h * y
    if degree > 2:
        a, b, c = r(0.5900435899266435), r(2.890611442640554), r(0.4570457994644658)
        d, e = r(0.3731763325901154), r(1.445305721320277)
        two, three, four, six, eight = r(2), r(3), r(4), r(6), r(8)
        xx, yy, zz = x * x, y * y, z * z
        basis[9, 0] = -a * y * (three * xx - yy)
        basis[9, 1], basis[9, 2] = -six * a * x * y, -three * a * (xx - yy)
        basis[10, 0] = b * x * y * z
        basis[10, 1], basis[10, 2], basis[10, 3] = b * y * z, b * x * z, b * x * y
        basis[11, 0] = -c * y * (four * zz - xx - yy)
        basis[11, 1], basis[11, 2] = two * c * x * y, -c * (four * zz - xx - three * yy)
        basis[11, 3] = -eight * c * y * z
        basis[12, 0] = d * z * (two * zz - three * xx - three * yy)
        basis[12, 1], basis[12, 2] = -six * d * x * z, -six * d * y * z
        basis[12, 3] = d * (six * zz - three * xx - three * yy)
        basis[13, 0] = -c * x * (four * zz - xx - yy)
        basis[13, 1], basis[13, 2] = -c * (four * zz - three * xx - yy), two * c * x * y
        basis[13, 3] = -eight * c * x * z
        basis[14, 0] = e * z * (xx - yy)
        basis[14, 1], basis[14, 2], basis[14, 3] = two * e * x * z, -two * e * y * z, e * (xx - yy)
        basis[15, 0] = -a * x * (xx - three * yy)
        basis[15, 1], basis[15, 2] = -three * a * (xx - yy), six * a * x * y


@njit(**_THREAD)
def project(
    means, log_scales, quaternions, logits, sh, extra, shift, cam, degree, shape, splats, values,
    first, last,
):  # fmt: skip
    """Fill `splats` (n, SPLAT) and `values` (n, 4 + extra) of Gaussians `first` to `last`.

    Parameters
    ----------
    shift : array (n, 2)
        Added to the centres on the picture, in pixels.
    cam : array
        See `PinholeCamera.packed`.
    shape : (height, width) of the picture
    """
    r = splats.dtype.type
    zero, one, two = r(0), r(1), r(2)
    basis = np.empty((16, 4), splats.dtype)
    terms = (degree + 1) ** 2
    height, width = r(shape[0]), r(shape[1])
    for i in range(first, last):
        splats[i, HALF_WIDTH] = splats[i, HALF_HEIGHT] = zero
        x, y, z = _in_camera(means[i], cam)
        opacity = one / (one + math.exp(-logits[i]))
        if not (z > cam[21] and opacity > r(MIN_ALPHA)):
            continue
        px = (cam[12] * x + cam[14] * y) / z + cam[15] + shift[i, 0]
        py = cam[13] * y / z + cam[16] + shift[i, 1]
        u = min(max(x / z, cam[17]), cam[18])
        v = min(max(y / z, cam[19]), cam[20])
        turn, _, _ = _rotation(quaternions[i], one, two)
        scales = (
            math.exp(log_scales[i, 0]), math.exp(log_scales[i, 1]), math.exp(log_scales[i, 2]),
        )  # fmt: skip
        _, _, U = _axes_on_picture(turn, scales, cam, u, v, z)
        a = U[0] * U[0] + U[1] * U[1] + U[2] * U[2] + r(LOW_PASS)
        b = U[0] * U[3] + U[1] * U[4] + U[2] * U[5]
        c = U[3] * U[3] + U[4] * U[4] + U[5] * U[5] + r(LOW_PASS)
        det = a * c - b * b
        cut = -math.log(opacity / r(MIN_ALPHA))
        half_width = math.sqrt(-two * cut * a) + r(_SLACK)
        half_height = math.sqrt(-two * cut * c) + r(_SLACK)
        if not (
            px + half_width > zero and px - half_width < width
            and py + half_height > zero and py - half_height < height and det > zero
        ):  # fmt: skip
            continue
        splats[i, X], splats[i, Y] = px, py
        splats[i, A], splats[i, B], splats[i, C] = c / det, -b / det, a / det
        splats[i, OPACITY], splats[i, CUT] = opacity, cut
        splats[i, HALF_WIDTH], splats[i, HALF_HEIGHT] = half_width, half_height
        dx, dy, dz = means[i, 0] - cam[22], means[i, 1] - cam[23], means[i, 2] - cam[24]
        away = math.sqrt(dx * dx + dy * dy + dz * dz)
        _harmonics(degree, dx / away, dy / away, dz / away, basis)
        for channel in range(3):
            colour = r(0.5)
            for k in range(terms):
                colour += basis[k, 0] * sh[i, k, channel]
            values[i, channel] = max(colour, zero)
        values[i, 3] = z
        for e in range(extra.shape[1]):
            values[i, 4 + e] = extra[i, e]


@njit(**_THREAD)
def project_backward(
    means, log_scales, quaternions, logits, sh, cam, degree, splats, values, entry_grads, slots,
    slot_starts, d_means, d_scales, d_quaternions, d_logits, d_sh, d_extra, d_shift, first, last,
):  # fmt: skip
    """Gradients of Gaussians `first` to `last` from those of their splats.

    Parameters
    ----------
    entry_grads : array (entries, MOMENTS + channels)
        Gradients of each splat in each tile, see `tile_kernels.composite_backward`.
    slots, slot_starts : arrays
        Which entries belong to each Gaussian, in a fixed order.
    d_... : arrays
        Filled with the gradients; zero where a Gaussian is not in sight. `d_shift` (n, 2) is the
        gradient of the centre on the picture, in 1 / pixel.
    """
    r = splats.dtype.type
    zero, half, one, two = r(0), r(0.5), r(1), r(2)
    basis = np.empty((16, 4), splats.dtype)
    columns = entry_grads.shape[1]
    g, dR = np.empty(columns, splats.dtype), np.empty(9, splats.dtype)
    terms = (degree + 1) ** 2
    for i in range(first, last):
        d_means[i] = d_scales[i] = d_quaternions[i] = d_shift[i] = d_logits[i] = zero
        d_sh[i] = zero
        d_extra[i] = zero
        if splats[i, HALF_WIDTH] == zero:
            continue
        g[:] = zero
        for s in range(slot_starts[i], slot_starts[i + 1]):
            for k in range(columns):
                g[k] += entry_grads[slots[s], k]
        opacity, p, q, w = splats[i, OPACITY], splats[i, A], splats[i, B], splats[i, C]
        d_logits[i] = g[0] * (one - opacity)
        d_px, d_py = p * g[1] + q * g[2], q * g[1] + w * g[2]
        d_shift[i, 0], d_shift[i, 1] = d_px, d_py
        # the inverse covariance Q has gradient G; the covariance then has -Q G Q
        g00, g01, g11 = -half * g[3], -half * g[4], -half * g[5]
        m00, m01 = p * g00 + q * g01, p * g01 + q * g11
        m10, m11 = q * g00 + w * g01, q * g01 + w * g11
        da = -(m00 * p + m01 * q)
        db = -two * (m00 * q + m01 * w)
        dc = -(m10 * q + m11 * w)

        x, y, z = _in_camera(means[i], cam)
        u0, v0 = x / z, y / z
        u, v = min(max(u0, cam[17]), cam[18]), min(max(v0, cam[19]), cam[20])
        turn, unit, length = _rotation(quaternions[i], one, two)
        scales = (
            math.exp(log_scales[i, 0]), math.exp(log_scales[i, 1]), math.exp(log_scales[i, 2]),
        )  # fmt: skip
        V, slopes, U = _axes_on_picture(turn, scales, cam, u, v, z)
        fx, fy, skew = cam[12], cam[13], cam[14]
        d_u, d_v = zero, zero
        d_z = g[MOMENTS + 3]
        for k in range(3):
            U0, U1 = U[k], U[3 + k]
            dU0, dU1 = two * da * U0 + db * U1, two * dc * U1 + db * U0
            da_k, db_k = fx * dU0 / z, (skew * dU0 + fy * dU1) / z
            d_u -= da_k * V[6 + k]
            d_v -= db_k * V[6 + k]
            d_z -= da_k * slopes[k] + db_k * slopes[3 + k]
            dV2 = -(u * da_k + v * db_k)
            d_log = zero
            for j in range(3):  # world from camera
                dM = cam[j] * da_k + cam[3 + j] * db_k + cam[6 + j] * dV2
                d_log += dM * turn[3 * j + k]
                dR[3 * j + k] = dM * scales[k]
            d_scales[i, k] = d_log * scales[k]
        d_u = d_u if u == u0 else zero
        d_v = d_v if v == v0 else zero
        d_u += fx * d_px
        d_v += skew * d_px + fy * d_py
        d_x, d_y = d_u / z, d_v / z
        d_z -= (d_u * u0 + d_v * v0) / z

        qw, qx, qy, qz = unit
        dw = two * (
            qx * (dR[7] - dR[5]) + qy * (dR[2] - dR[6]) + qz * (dR[3] - dR[1])
        )  # fmt: skip
        dx = two * (
            qy * (dR[1] + dR[3]) + qz * (dR[2] + dR[6]) + qw * (dR[7] - dR[5])
            - two * qx * (dR[4] + dR[8])
        )  # fmt: skip
        dy = two * (
            qx * (dR[1] + dR[3]) + qz * (dR[5] + dR[7]) + qw * (dR[2] - dR[6])
            - two * qy * (dR[0] + dR[8])
        )  # fmt: skip
        dz = two * (
            qx * (dR[2] + dR[6]) + qy * (dR[5] + dR[7]) + qw * (dR[3] - dR[1])
            - two * qz * (dR[0] + dR[4])
        )  # fmt: skip
        along = dw * qw + dx * qx + dy * qy + dz * qz
        d_quaternions[i, 0] = (dw - along * qw) / length
        d_quaternions[i, 1] = (dx - along * qx) / length
        d_quaternions[i, 2] = (dy - along * qy) / length
        d_quaternions[i, 3] = (dz - along * qz) / length

        dx, dy, dz = means[i, 0] - cam[22], means[i, 1] - cam[23], means[i, 2] - cam[24]
        away = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / away, dy / away, dz / away
        _harmonics(degree, dx, dy, dz, basis)
        ex, ey, ez = zero, zero, zero
        for channel in range(3):
            d_colour = g[MOMENTS + channel] if values[i, channel] > zero else zero
            for k in range(terms):
                d_sh[i, k, channel] = basis[k, 0] * d_colour
                part = sh[i, k, channel] * d_colour
                ex += part * basis[k, 1]
                ey += part * basis[k, 2]
                ez += part * basis[k, 3]
        along = ex * dx + ey * dy + ez * dz
        d_means[i, 0] = cam[0] * d_x + cam[3] * d_y + cam[6] * d_z + (ex - along * dx) / away
        d_means[i, 1] = cam[1] * d_x + cam[4] * d_y + cam[7] * d_z + (ey - along * dy) / away
        d_means[i, 2] = cam[2] * d_x + cam[5] * d_y + cam[8] * d_z + (ez - along * dz) / away
        for e in range(d_extra.shape[1]):
            d_extra[i, e] = g[MOMENTS + 4 + e]
