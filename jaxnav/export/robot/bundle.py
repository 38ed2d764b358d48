"""Reads what lies in a bundle, and nothing that was changed since it was written. Written for Python 3.6."""

import hashlib
import io
import json
import os
import zipfile

import numpy as np

SCHEMA = 1  # of contract.json
HERE = os.path.dirname(os.path.abspath(__file__))


class BundleError(Exception):
    """The bundle is incomplete, damaged, or of another version; the message says what helps."""


def load_contract(bundle=HERE):
    """contract.json of a bundle as a dict. BundleError: missing, damaged, edited, or of another schema."""
    path = os.path.join(bundle, "contract.json")
    try:
        with open(path, encoding="utf-8") as file:
            contract = json.load(file)
        schema = contract["schema"]
        stated = contract.pop("checksum")
    except OSError as error:
        raise BundleError("%s can't be read (%s): copy the whole bundle" % (path, error.strerror))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BundleError("%s is damaged (%r): copy the bundle again" % (path, error))
    if schema != SCHEMA:
        raise BundleError(
            "%s has schema %r, bundle.py reads %d: use the one that came with it" % (path, schema, SCHEMA)
        )
    if checksum(contract) != stated:
        raise BundleError("%s was edited: it no longer fits its checksum; copy the bundle again" % path)
    return contract


def checksum(contract):
    """SHA-256 of a contract, whatever the order of its entries."""
    text = json.dumps(contract, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def read_file(bundle, contract, name):
    """The bytes of one of the bundle's files. BundleError: missing, or not the file that the contract speaks of."""
    path = os.path.join(bundle, name)
    try:
        with open(path, "rb") as file:
            content = file.read()
    except OSError as error:
        raise BundleError("%s can't be read (%s): copy the whole bundle" % (path, error.strerror))
    if hashlib.sha256(content).hexdigest() != contract["files"].get(name):
        raise BundleError("%s is not the file that contract.json was written with: copy the bundle again" % path)
    return content


def load_arrays(bundle, contract, name):
    """{name: array} of one of the bundle's .npz files. No pickled object is ever loaded."""
    try:
        with np.load(io.BytesIO(read_file(bundle, contract, name)), allow_pickle=False) as file:
            return {key: file[key] for key in file.files}
    except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise BundleError("%s can't be loaded (%s): copy the bundle again" % (os.path.join(bundle, name), error))
