"""Recordings cut into what arrives together, and tracks held against a batch."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np


def take(table, rows):
    columns = {}
    for entry in dataclasses.fields(table):
        value = getattr(table, entry.name)
        if entry.name == "kind":
            value = tuple(value[row] for row in rows)
        elif entry.name != "emission_names":
            value = value[rows]
        columns[entry.name] = value
    return type(table)(**columns)


def tables(recording):
    held = list(recording.tables.values())
    return held if recording.constraints is None else [*held, recording.constraints]


def parts(recording, edges=None, *, every=None):
    """Return lists of tables, in the order of time, cut at edges or every so many times."""
    held = tables(recording)
    times = [np.where(np.isnan(t.time_s), -np.inf, t.time_s) for t in held]
    if edges is None:
        edges = np.unique(np.concatenate(times))[::every]
    edges = np.concatenate([[-np.inf], edges, [np.inf]])
    for low, high in pairwise(edges):
        chosen = [np.flatnonzero((t >= low) & (t < high)) for t in times]
        found = [take(t, rows) for t, rows in zip(held, chosen, strict=True) if rows.size]
        if found:
            yield found


def feed(smoother, recording, **how):
    for part in parts(recording, **how):
        smoother.update(part)
    return smoother


def differences(track, batch):
    """Return the greatest distance in posterior sigmas and relative error of a covariance."""
    there = batch.at(track.time_s)
    gap = track.position_m - there.position_m
    root = np.linalg.cholesky(there.position_covariance_m2)
    sigmas = np.linalg.norm(np.linalg.solve(root, gap[:, :, None])[:, :, 0], axis=1)
    half = np.linalg.solve(root, track.position_covariance_m2)
    ratio = np.linalg.solve(root, np.swapaxes(half, 1, 2))
    return sigmas.max(), np.abs(np.linalg.eigvalsh(ratio) - 1.0).max()


def newest_sigmas(estimate, batch):
    there = batch.at(estimate.time_s)
    gap = estimate.state[:3] - there.position_m[0]
    return np.sqrt(gap @ np.linalg.solve(there.position_covariance_m2[0], gap))
