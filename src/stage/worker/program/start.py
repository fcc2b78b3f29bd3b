"""Read USD stages for surflux: JSON lines in, JSON lines out, arrays through a flat file.

One program of four parts, in this order: start, values, loader, worker.

Requests (one JSON object a line on stdin):
  {"open": PATH, "scratch": [FOLDER, ...]}
  {"load": {"time": NUMBER|null, "mask": [PATH], "attributes": [NAME|PREFIX*], "values_not_needed": [...],
            "composition": {"load": "all"|"none", "variants": [[PRIM, SET, CHOICE]], "session": PATH|null, "muted": [ID]},
            "keep": BOOL}}
 With "keep", loads that differ in time only read again what varies; the other arrays are named by their place in the
 file of the first of them ("kept" instead of "array").
  {"validate": {}}
Replies (one line on stdout each): {"ok": ...} or {"error": MESSAGE}; the very first line says what was imported.
All numbers keep the memory order of USD: a row-vector matrix read as columns is its transpose.
"""
import gc
import itertools
import json
import os
import re
import shutil
import signal
import sys
import tempfile

# `python -c` puts the current folder first: a file called numpy.py there must not be imported.
if sys.path and sys.path[0] == "":
    del sys.path[0]

# An index is a tree: nothing here runs in circles, and looking for that takes a third of a walk over 100 000 prims.
gc.disable()

# Ctrl-C in a terminal goes to the whole group; surflux decides what it means and ends this process itself.
signal.signal(signal.SIGINT, signal.SIG_IGN)

# USD and its plug-ins print to stdout: keep the protocol's own copy and send everything else to stderr.
REQUESTS = os.fdopen(os.dup(0), "r", encoding="utf-8")
REPLIES = os.fdopen(os.dup(1), "w", encoding="utf-8")
os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
os.dup2(2, 1)
sys.stdout = sys.stderr


def reply(message):
    REPLIES.write(json.dumps(message, separators=(",", ":"), allow_nan=False))
    REPLIES.write("\n")
    REPLIES.flush()


try:
    import numpy
    from pxr import Ar, Sdf, Tf, Usd, UsdUtils
except BaseException as problem:  # a broken installation may raise anything
    reply({"error": "cannot import pxr and numpy: %s: %s" % (type(problem).__name__, problem)})
    sys.exit(1)

ALIGNMENT = 64
# Bytes to write at a time.
BATCH = 1 << 20
UDIM = "<UDIM>"
PROTOTYPE = re.compile(r"/__Prototype_[0-9]+(?=[/.]|$)")
FALLBACK_SOURCES = (Usd.ResolveInfoSourceFallback, Usd.ResolveInfoSourceNone)
# Methods, called with their object as an argument: `prim.GetPath()` looks first whether the prim has not expired, which takes
# three times as long as the method. No stage changes while it is walked.
get_path = Usd.Object.GetPath
get_name = Usd.Object.GetName
get_metadata = Usd.Object.GetMetadata
has_metadata = Usd.Object.HasAuthoredMetadata
get_type_name = Usd.Prim.GetTypeName
get_kind = Usd.Prim.GetKind
get_schemas = Usd.Prim.GetAppliedSchemas
get_properties = Usd.Prim.GetAuthoredProperties
is_instance = Usd.Prim.IsInstance
get_prototype = Usd.Prim.GetPrototype
get_targets = Usd.Relationship.GetTargets
get_value_type = Usd.Attribute.GetTypeName
get_value = Usd.Attribute.Get
get_resolve_info = Usd.Attribute.GetResolveInfo
get_source = Usd.ResolveInfo.GetSource
has_connections = Usd.Attribute.HasAuthoredConnections
has_color_space = Usd.Attribute.HasColorSpace
might_vary = Usd.Attribute.ValueMightBeTimeVarying

# Looked up in their modules, these take longer than to be compared.
RELATIONSHIP = Usd.Relationship
DEFAULT_SOURCE = Usd.ResolveInfoSourceDefault
