"""Sensors that are wrong, loose or nearly in a plane: what is found, named, or said to be open."""

import numpy as np
import pytest
from made_receivers import late, moved, world
from test_left_open import arrivals_of

import geograph as gg
from geograph.scenarios.sound import Microphones, microphones_world
from geograph.solver import Status


@pytest.mark.parametrize("wrong", ["clock", "place"])
def test_one_wrong_sensor_of_seven_is_named_and_does_no_harm(wrong):
    made = world(7, [1e3, 2.5e3, 900.0])
    recording = (
        late(made.recording, 3, 1e-3)
        if wrong == "clock"
        else moved(made.recording, 3, [300.0, -400.0, 0.0])
    )
    track = gg.smooth(recording)
    name = recording.sensor_names[3]
    assert np.linalg.norm(track.position_m[0] - made.path.position_at(0.0)) < 40.0
    flagged = track.summary["flagged_sensors"]
    assert [text.split(":")[0] for text in flagged] == [name]
    assert "clock offset" in flagged[0]
    assert "position error" in flagged[0]


def test_one_wrong_clock_of_five_is_left_out_as_a_whole_along_a_path():
    # A hundred times its prior. Before it was rejected by half, and drew the path 6.7 km off.
    recording, path = arrivals_of(1, last_prior_s=100e-9)
    track = gg.smooth(recording, process_noise=0.3)
    # The sigma is 150 m without it.
    assert np.median(np.linalg.norm(track.position_m - path(track.time_s), axis=1)) < 500.0
    sensors = track.summary["sensors"]
    lost = [entry["rejected"] / entry["measurements"] for entry in sensors.values()]
    assert lost[4] == 1.0
    assert max(lost[:4]) < 0.1
    flagged = track.summary["flagged_sensors"]
    assert [text.split(":")[0] for text in flagged] == [recording.sensor_names[4]]


def test_with_five_sensors_it_is_said_that_another_one_could_be_wrong():
    """Four sensors fit any place in space exactly: which of five is wrong cannot be seen."""
    recording = moved(world(5, [1e3, 2.5e3, 900.0]).recording, 3, [300.0, -400.0, 0.0])
    track = gg.smooth(recording, raise_on_failure=False)
    assert track.status is Status.UNOBSERVABLE
    (said,) = [text for text in track.summary["weakly_observed"] if "rest agrees" in text]
    assert recording.sensor_names[3] in said


def test_a_mirror_image_behind_the_microphones_is_not_taken_for_the_path():
    made = microphones_world(0, Microphones(clock_offset_s=5e-3, clock_drift_s_s=5e-4))
    track = gg.smooth(made.recording, raise_on_failure=False)
    error = track.position_m - made.path.position_at(track.time_s)
    # In the image of the path it is 58 m.
    assert np.linalg.norm(error, axis=1).mean() < 5.0
    assert track.summary["chi2"] < 1.5 * track.summary["degrees_of_freedom"]


def test_microphones_whose_clocks_are_off_by_seconds():
    made = microphones_world(0, Microphones(clock_offset_s=2.0, claps=25))
    track = gg.smooth(made.recording, raise_on_failure=False)
    assert track.status in (Status.CONVERGED, Status.UNOBSERVABLE)
    assert np.isfinite(track.summary["cost"])
    freedom = track.summary["degrees_of_freedom"]
    # Noise has a chi-square of the degrees of freedom; paths that run off had one of zero.
    assert 0.5 * freedom < track.summary["chi2"] < 1.6 * freedom
