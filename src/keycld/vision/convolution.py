"""A convolution whose gradients XLA computes fast inside loops too.

XLA's CPU compiler has fast kernels for convolutions in one layout only, NHWC with HWIO kernels, and brings others into
it only outside of loops. JAX writes the gradient of a kernel in another layout, so in a loop over training steps it
took the slow path, thirty times slower (jax issue 12868). Here the gradients are convolutions of that layout.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array, Float

_LAYOUT = ("NHWC", "HWIO", "NHWC")


def convolve(
    x: Float[Array, "n h w inputs"], kernel: Float[Array, "size size inputs outputs"], stride: int = 1
) -> Float[Array, "n h2 w2 outputs"]:
    """Convolve pictures with a kernel, zeros around them (padding "SAME").

        y[n, i, j, o] = Σ_abc x[n, s·i + a − p, s·j + b − p, c] · kernel[a, b, c, o]

    s is the stride and p the padding above and to the left. Equal to `jax.lax.conv_general_dilated` in value and
    gradients, up to rounding.

    Args:
        x: pictures, channels last.
        kernel: of the same floating-point type.
        stride: pixels between outputs.
    """
    return _convolve.bind(x, kernel, stride=stride)


def convolve_doubled(
    x: Float[Array, "n h w inputs"], kernel: Float[Array, "3 3 inputs outputs"]
) -> Float[Array, "n h2 w2 outputs"]:
    """Convolve pictures that are doubled first, each pixel repeated along both axes.

    Equal to `convolve` of the doubled pictures, up to rounding, with 4/9 of its multiplications and a quarter of its
    pixels: three doubled rows are two rows of the picture, and each pixel of it gives four outputs, as channels, from
    kernels of 2×2 pixels whose numbers are sums of the given ones.
    """
    n, h, w, inputs = x.shape
    outputs = kernel.shape[-1]
    # Of the two rows below a boundary between rows of the picture: [row, row of the picture, row of the kernel].
    sums = jnp.array([[[1, 1, 0], [0, 0, 1]], [[1, 0, 0], [0, 1, 1]]], kernel.dtype)
    four = jnp.einsum("pas,qbt,stio->abipqo", sums, sums, kernel).reshape(2, 2, inputs, 4 * outputs)
    around = jnp.pad(x, ((0, 0), (1, 0), (1, 0), (0, 0)))  # Padding "SAME" of an even kernel adds the last zeros.
    y = convolve(around, four).reshape(n, h + 1, w + 1, 2, 2, outputs).transpose(0, 1, 3, 2, 4, 5)
    return y.reshape(n, 2 * h + 2, 2 * w + 2, outputs)[:, 1:-1, 1:-1]


_convolve = Primitive("keycld_convolve")


def _forward(x, kernel, *, stride):
    return jax.lax.conv_general_dilated(x, kernel, (stride, stride), "SAME", dimension_numbers=_LAYOUT)


def _over_pictures(cotangent, x, kernel, *, stride):
    """Return the gradient of the pictures: the cotangent, spread by the stride, with the turned kernel."""
    size, padding = kernel.shape[0], []
    for length, out, low in _sizes(x.aval.shape, cotangent.shape, size, stride):
        padding.append((size - 1 - low, length + low - 1 - (out - 1) * stride))
    turned = kernel[::-1, ::-1].swapaxes(2, 3)
    return _spread.bind(cotangent, turned, padding=tuple(padding), pictures=stride, kernels=1)


def _over_kernel(cotangent, x, kernel, *, stride):
    """Return the gradient of the kernel: a convolution over the pictures, whose channels are its batch."""
    size, padding = kernel.aval.shape[0], []
    for length, out, low in _sizes(x.shape, cotangent.shape, size, stride):
        padding.append((low, (out - 1) * stride + size - length - low))
    across, along = x.transpose(3, 1, 2, 0), cotangent.transpose(1, 2, 0, 3)
    gradient = _spread.bind(across, along, padding=tuple(padding), pictures=1, kernels=stride)
    return gradient.transpose(1, 2, 0, 3)


def _sizes(x, y, size, stride):
    """Return input length, output length and zeros before the first pixel, of height and width."""
    lows = [low for low, _ in jax.lax.padtype_to_pads(x[1:3], (size, size), (stride, stride), "SAME")]
    return zip(x[1:3], y[1:3], lows, strict=True)


# The gradients: zeros between the pixels of the pictures, or of the kernel.
_spread = Primitive("keycld_convolve_spread")


def _spread_forward(x, kernel, *, padding, pictures, kernels):
    return jax.lax.conv_general_dilated(
        x,
        kernel,
        (1, 1),
        padding,
        lhs_dilation=(pictures, pictures),
        rhs_dilation=(kernels, kernels),
        dimension_numbers=_LAYOUT,
    )


def _spread_over_x(cotangent, x, kernel, **how):
    return jax.linear_transpose(lambda x: _spread_forward(x, kernel, **how), x.aval)(cotangent)[0]


def _spread_over_kernel(cotangent, x, kernel, **how):
    return jax.linear_transpose(lambda kernel: _spread_forward(x, kernel, **how), kernel.aval)(cotangent)[0]


def _batched(primitive, arguments, axes, **how):
    x, kernel = arguments
    if axes[1] is None:
        x = jnp.moveaxis(x, axes[0], 0)
        y = primitive.bind(x.reshape(-1, *x.shape[2:]), kernel, **how)
        return y.reshape(*x.shape[:2], *y.shape[1:]), 0
    # Several kernels, as of several models, one after the other: in XLA's form for all of them, groups of channels,
    # they are slow.
    kernels = jnp.moveaxis(kernel, axes[1], 0)
    pictures = [x] * len(kernels) if axes[0] is None else jnp.moveaxis(x, axes[0], 0)
    return jnp.stack([primitive.bind(*pair, **how) for pair in zip(pictures, kernels, strict=True)]), 0


def _define(primitive, forward, over_x, over_kernel, names):
    def shape(x, kernel, **how):
        result = jax.eval_shape(partial(forward, **how), x, kernel)
        return x.update(shape=result.shape, dtype=result.dtype, weak_type=False)

    primitive.def_impl(jax.jit(forward, static_argnames=names))
    primitive.def_abstract_eval(shape)
    ad.defbilinear(primitive, over_x, over_kernel)
    batching.primitive_batchers[primitive] = partial(_batched, primitive)
    mlir.register_lowering(primitive, mlir.lower_fun(forward, multiple_results=False))


_define(_convolve, _forward, _over_pictures, _over_kernel, ("stride",))
_define(_spread, _spread_forward, _spread_over_x, _spread_over_kernel, ("padding", "pictures", "kernels"))
