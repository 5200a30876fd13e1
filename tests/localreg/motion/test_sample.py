"""The sample set, checked against the body positions stored with it."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax import vmap

import localreg.motion.formats.sample as sample
from localreg.body.kinematics import Kinematics
from localreg.body.skeleton import BODY_NAMES
from localreg.errors import MotionError

# The stored bodies are the humanoid's but the root, with an eye behind the head.
STORED = {name: BODY_NAMES.index(name) - 1 for name in BODY_NAMES[1:17]} | {
    name: BODY_NAMES.index(name) for name in BODY_NAMES[17:]
}


@pytest.fixture(scope="module")
def motions():
    return sample.read_sample()


def test_the_set_is_complete(motions):
    assert len(motions) == 36
    assert sum(map(len, motions)) == 4409
    assert {motion.provenance.subject for motion in motions} == {"16", "47", "56", "69"}
    assert len({motion.provenance.trial for motion in motions}) == 36
    first = motions[0]
    assert (first.provenance.name, first.provenance.trial) == ("16_22", "16_22")
    assert first.provenance.activity == "walk"
    assert first.rate == pytest.approx(1.0 / 0.03)


@pytest.mark.parametrize("index", [0, 15, 23])
def test_our_kinematics_places_the_bodies_where_the_set_says(motions, index):
    motion = motions[index].first(60)
    folder = sample.sample_folder()
    clip = sample.read_clips(folder / "mocap_2020.bin")[index]
    stored = clip.fields["body_positions"].reshape(-1, 31, 3)[: len(motion)]
    kinematics = Kinematics.from_subject(motion.subject)
    ours = vmap(kinematics.forward)(jnp.asarray(motion.qpos)).positions[:, 1:]
    for name, column in STORED.items():
        error = np.linalg.norm(ours[:, BODY_NAMES.index(name)] - stored[:, column], axis=1).max()
        if "thumb" in name:  # hangs on the hand there, on the wrist here
            assert error > 0.02
        elif "fingers" in name:  # turns about an axis beside its origin there
            assert error < 0.03
        else:
            assert error < 1e-4, name


def test_the_walks_stand_on_the_floor_and_face_forward(motions):
    for motion in motions:
        height = motion.qpos[:, 2]
        assert 0.8 < height.min() < height.max() < 1.3


def test_without_the_package_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setattr(sample, "find_spec", lambda name: None)
    with pytest.raises(MotionError, match=r"pip install 'localreg-mocap\[sample\]'"):
        sample.read_sample()


@pytest.mark.parametrize("length", [9, 12, 40, 3000])
def test_a_clip_file_cut_short_is_an_error(tmp_path, length):
    data = (sample.sample_folder() / "mocap_2020.bin").read_bytes()
    path = tmp_path / "cut.bin"
    path.write_bytes(data[:length])
    with pytest.raises(MotionError, match="damaged"):
        sample.read_clips(path)


def test_another_file_is_an_error(tmp_path):
    path = tmp_path / "other.bin"
    path.write_bytes(b"RIFF....")
    with pytest.raises(MotionError, match="lacks the mark"):
        sample.read_clips(path)
    with pytest.raises(MotionError, match="not the expected CMU humanoid"):
        sample.read_humanoid(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name="lthumbrx"', 'name="lthumbrw"', "its joints are others"),
        ('<body name="lhipjoint">', '<body name="tail">', "lhipjoint"),
        ('<body name="root"', '<body name="trunk"', "no body named root"),
        ('pos="0 -0.404945 0"', 'pos="0 low 0"', "could not convert"),
    ],
)
def test_another_humanoid_is_an_error(tmp_path, old, new, message):
    folder = sample.sample_folder() / "locomotion/walkers/assets"
    text = (folder / "humanoid_CMU_V2020.xml").read_text()
    assert old in text
    path = tmp_path / "other.xml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(MotionError, match=message):
        sample.read_humanoid(path)
