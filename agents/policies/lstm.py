"""The recurrent policy of sb3-contrib, several times faster to train."""

import torch
from sb3_contrib.common.recurrent.policies import RecurrentActorCriticPolicy

LstmStates = tuple[torch.Tensor, torch.Tensor]
"""Hidden and cell state, ``(1, sequences, hidden)`` each."""


class LstmPolicy(RecurrentActorCriticPolicy):
    """sb3-contrib's ``MlpLstmPolicy``, with one call of the network for a batch of sequences.

    sb3-contrib looks for episodes that begin inside a sequence, and steps through all of them where
    it finds a beginning. But its buffer cuts the sequences where episodes begin: only a first step
    can be one.
    """

    @staticmethod
    def _process_sequence(  # type: ignore[override]  # whose declared type is wrong
        features: torch.Tensor,
        lstm_states: LstmStates,
        episode_starts: torch.Tensor,
        lstm: torch.nn.LSTM,
    ) -> tuple[torch.Tensor, LstmStates]:
        """Outputs ``(sequences x steps, hidden)``, sequence after sequence, and the last states."""
        hidden, cell = lstm_states
        sequences = hidden.shape[1]
        goes_on = 1.0 - episode_starts.reshape(sequences, -1)[:, :1]
        steps_first = features.reshape(sequences, -1, lstm.input_size).swapaxes(0, 1)
        output, states = lstm(steps_first, (goes_on * hidden, goes_on * cell))
        return output.swapaxes(0, 1).flatten(0, 1), states
