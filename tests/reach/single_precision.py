"""Evaluations of networks in a floating-point format, as different runtimes order and fuse their sums."""

import numpy as np

from reach.networks.layers import Affine


def _sequential(parts, dtype):
    total = np.zeros_like(parts[..., 0])
    for j in range(parts.shape[-1]):
        total = (total + parts[..., j]).astype(dtype)
    return total


def _pairwise(parts, dtype):
    while parts.shape[-1] > 1:
        odd = parts[..., -1:] if parts.shape[-1] % 2 else parts[..., :0]
        pairs = (parts[..., :-1:2] + parts[..., 1::2])[..., : parts.shape[-1] // 2]
        parts = np.concatenate([pairs, odd], axis=-1).astype(dtype)
    return parts[..., 0]


def _fused(layer, x, dtype):
    total = np.broadcast_to(layer.b.astype(dtype), (*x.shape[:-1], len(layer.b)))
    wide = np.longdouble if dtype == np.float64 else np.float64
    for j in range(x.shape[-1]):
        product = x[..., j : j + 1].astype(wide) * layer.W[:, j].astype(dtype).astype(wide)
        total = (product + total).astype(dtype)
    return total


def evaluated(network, x, dtype=np.float32, order="blas", scale=1.0):
    """Outputs for inputs (..., n), every operation rounded to a format; sums in an order."""
    flush = order == "flushed"
    y = np.asarray(x).astype(dtype) * np.asarray(scale).astype(dtype)
    for layer in network.layers:
        if isinstance(layer, Affine) and order == "fused":
            y = _fused(layer, y, dtype)
        elif isinstance(layer, Affine) and order != "blas":
            parts = y[..., None, :] * layer.W.astype(dtype)
            bias = np.broadcast_to(layer.b.astype(dtype), parts.shape[:-1])[..., None]
            ends = (bias, parts) if order == "bias first" else (parts, bias)
            parts = np.concatenate(ends, axis=-1)
            parts = np.where(np.abs(parts) < np.finfo(dtype).tiny, 0, parts).astype(dtype) if flush else parts
            parts = parts[..., ::-1] if order == "reversed" else parts
            y = _pairwise(parts, dtype) if order == "pairwise" else _sequential(parts, dtype)
        else:
            y = layer(y)
        y = np.where(np.abs(y) < np.finfo(dtype).tiny, 0, y).astype(dtype) if flush else y.astype(dtype)
    return y.astype(float)


ORDERS = ("blas", "forward", "reversed", "pairwise", "bias first", "fused", "flushed")
