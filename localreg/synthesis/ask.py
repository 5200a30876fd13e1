"""What is asked of the database: the past, and what the trackers that are heard say now."""

from typing import no_type_check

import numpy as np
from numba import njit

from localreg.body.chain import Chain, blank_placed, place
from localreg.body.skeleton import QPOS_SIZE
from localreg.database.features import FeatureLayout, write_features, write_trust
from localreg.database.neighbours import Query
from localreg.synthesis.attention import Attention, listen
from localreg.synthesis.observation import Observation
from localreg.synthesis.state import State, coast


def ask(
    chain: Chain, layout: FeatureLayout, state: State, observation: Observation
) -> tuple[Query, Attention]:
    """The query of a frame, and who was heard for it.

    Args:
        chain: the body that wears the trackers.
        layout: which feature column means what.
        state: after the frame before.
        observation: what the trackers say.
    """
    history, valid = np.asarray(state.history), np.asarray(state.history_valid)
    features, trust = np.empty(layout.size), np.empty(layout.size)
    away = np.empty_like(state.attention.away)
    unguided = _ask(
        chain, layout.reference, layout.others_array, np.asarray(state.qpos, dtype=float),
        np.asarray(state.velocity), history, valid, observation, state.attention,
        features, trust, away,
    )  # fmt: skip
    return Query(history, valid, features, trust, state.near), Attention(away, unguided)


@njit(cache=True)
@no_type_check
def _ask(
    chain, reference, others, qpos, velocity, history, history_valid, observation, attention,
    features, trust, away,
):  # fmt: skip
    """Write features, trust in them and who is far away; returns how long nobody has guided."""
    ahead = np.empty(QPOS_SIZE)
    coast(qpos, velocity, history, history_valid, ahead)
    placed = blank_placed(chain)
    place(chain, ahead, placed)
    heard, unguided = listen(
        observation, placed.site_position, placed.site_orientation, attention, reference, away
    )
    write_features(reference, others, heard.positions, heard.quaternions, features)
    write_trust(reference, others, heard.seen, heard.facing, heard.in_reference, trust)
    return unguided
