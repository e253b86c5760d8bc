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


_convolve = Primitive("keycld_convolve")


@_convolve.def_impl
def _run(x, kernel, *, stride):
    return _compiled(x, kernel, stride=stride)


def _forward(x, kernel, *, stride):
    return jax.lax.conv_general_dilated(x, kernel, (stride, stride), "SAME", dimension_numbers=_LAYOUT)


_compiled = jax.jit(_forward, static_argnames="stride")


@_convolve.def_abstract_eval
def _shape(x, kernel, *, stride):
    result = jax.eval_shape(partial(_forward, stride=stride), x, kernel)
    return x.update(shape=result.shape, dtype=result.dtype, weak_type=False)


def _over_pictures(cotangent, x, kernel, *, stride):
    """Return the gradient of the pictures: the cotangent, spread by the stride, with the turned kernel."""
    size, padding = kernel.shape[0], []
    for length, out, low in _sizes(x.aval.shape, cotangent.shape, size, stride):
        padding.append((size - 1 - low, length + low - 1 - (out - 1) * stride))
    turned = kernel[::-1, ::-1].swapaxes(2, 3)
    return jax.lax.conv_general_dilated(
        cotangent, turned, (1, 1), padding, lhs_dilation=(stride, stride), dimension_numbers=_LAYOUT
    )


def _over_kernel(cotangent, x, kernel, *, stride):
    """Return the gradient of the kernel: a convolution over the pictures, whose channels are its batch."""
    size, padding = kernel.aval.shape[0], []
    for length, out, low in _sizes(x.shape, cotangent.shape, size, stride):
        padding.append((low, (out - 1) * stride + size - length - low))
    across, along = x.transpose(3, 1, 2, 0), cotangent.transpose(1, 2, 0, 3)
    gradient = jax.lax.conv_general_dilated(
        across, along, (1, 1), padding, rhs_dilation=(stride, stride), dimension_numbers=_LAYOUT
    )
    return gradient.transpose(1, 2, 0, 3)


def _sizes(x, y, size, stride):
    """Return input length, output length and zeros before the first pixel, of height and width."""
    lows = [low for low, _ in jax.lax.padtype_to_pads(x[1:3], (size, size), (stride, stride), "SAME")]
    return zip(x[1:3], y[1:3], lows, strict=True)


def _batched(arguments, axes, *, stride):
    x, kernel = arguments
    if axes[1] is not None:
        # Several kernels at once, as for several models: XLA's own form.
        return jax.vmap(partial(_forward, stride=stride), axes)(x, kernel), 0
    x = jnp.moveaxis(x, axes[0], 0)
    y = _convolve.bind(x.reshape(-1, *x.shape[2:]), kernel, stride=stride)
    return y.reshape(*x.shape[:2], *y.shape[1:]), 0


ad.defbilinear(_convolve, _over_pictures, _over_kernel)
batching.primitive_batchers[_convolve] = _batched
mlir.register_lowering(_convolve, mlir.lower_fun(_forward, multiple_results=False))
