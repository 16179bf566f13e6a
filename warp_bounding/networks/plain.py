"""The plain twin of a network, with exits or without: layer by layer, one query, in Warp's own Python.

It reads each layer's copy for neurons in lanes: a row of biases, then a row of weights for each input, padded.
"""

import warp as wp

from warp_bounding.activations import ACTIVATIONS, SINE
from warp_bounding.kernels.plain import DENIED, GRANTED, Numbers, Words, twin, vector_type
from warp_bounding.kernels.source import Source

__all__ = ["plain_network"]


def plain_network(source: Source) -> wp.Function:
    """``f(w, words, at, v)``: the inputs, then one layer after the other (``_onwards``)."""
    vector, encode, onwards = vector_type(source.coordinates), _encode(source), _onwards(source, 0)

    @twin(source)
    def f(w: Numbers, words: Words, at: int, v: vector) -> float:
        return onwards(w, at, v, encode(w, at, v))

    return f


def _encode(source: Source) -> wp.Function:
    """The inputs of the first layer: coordinates, and features of the positional encoding."""
    raw, features, sine = source.raw, source.features, SINE.plain
    vector, inputs = vector_type(source.coordinates), vector_type(source.inputs)

    @twin(source, "encode")
    def encode(w: Numbers, at: int, v: vector) -> inputs:
        h = inputs()
        for k in range(raw):
            h[k] = v[k]
        if features:
            for j in range(at, at + features):
                z = w[j]
                for k in range(raw):
                    z += v[k] * w[at + features + (j - at) * raw + k]
                h[raw + j - at] = sine(z)
        return h

    return encode


def _layer(source: Source, index: int) -> wp.Function:
    """``act(W h + b)`` of hidden layer ``index``."""
    (inputs, neurons), (place, row) = source.layers[index], source.neuron_rows[index]
    act, below, above = ACTIVATIONS[source.activation].plain, vector_type(inputs), vector_type(neurons)

    @twin(source, f"layer_{index}")
    def layer(w: Numbers, at: int, h: below) -> above:
        y = above()
        for j in range(at + place, at + place + neurons):
            z = w[j]
            for k in range(inputs):
                z += h[k] * w[j + row * (k + 1)]
            y[j - at - place] = act(z)
        return y

    return layer


def _output(source: Source, index: int) -> wp.Function:
    """The output at ``w[at]`` behind hidden layer ``index``; of planes the lesser of two supports."""
    n, neurons, outputs = source.coordinates - 1, source.hidden[index], source.head.outputs
    second = source.head_size(index) // outputs
    vector, above = vector_type(source.coordinates), vector_type(neurons)

    @twin(source, f"output_{index}")
    def output(w: Numbers, at: int, v: vector, h: above) -> float:
        f = w[at]
        for j in range(neurons):
            f += h[j] * w[at + 1 + j]
        if outputs > 1:
            other = w[at + second]
            for j in range(neurons):
                other += h[j] * w[at + second + 1 + j]
            f = wp.min(f - v[n], other + v[n])
        return f

    return output


def _onwards(source: Source, index: int) -> wp.Function:
    """From the inputs of hidden layer ``index`` to f; DENIED or GRANTED where an exit behind it decides."""
    vector, below = vector_type(source.coordinates), vector_type(source.layers[index][0])
    layer, output, last = _layer(source, index), _output(source, index), source.places[-1]

    @twin(source, f"last_{index}")
    def finish(w: Numbers, at: int, v: vector, h: below) -> float:
        return output(w, at + last, v, layer(w, at, h))

    if index == len(source.hidden) - 1:
        return finish
    onwards, exits = _onwards(source, index + 1), len(source.exits) > 0
    door, grant = (source.exits[index], source.grants[index]) if exits else (0, 0)

    @twin(source, f"onwards_{index}")
    def go_on(w: Numbers, at: int, v: vector, h: below) -> float:
        y = layer(w, at, h)
        if exits:
            if output(w, at + door + 1, v, y) < w[at + door]:
                return DENIED
            if output(w, at + grant + 1, v, y) > w[at + grant]:
                return GRANTED
        return onwards(w, at, v, y)

    return go_on
