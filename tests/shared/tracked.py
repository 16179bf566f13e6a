"""What float32 rounds in a method's f, derived from its C text alone: the text, compiled with another kind of number.

Each number carries the float32 value that the operations of the text give, an interval of float64 that holds what they
would give without any rounding, and a running bound of the difference of both (Wilkinson's running error analysis),
operation by operation: u = 2^-24 of each result, 2^-126 where one may be flushed, and what the operands are off by.
None of it is read from ``rounding_bound``, or from anything that a method says of itself. Where two numbers are
compared that rounding could exchange, both take the larger bound, since either may be the one that is kept.

The sine ends with the bits of an integer, so of it two lines are replaced: any whole number of half turns is as good as
any other, and what the polynomial is off by is measured against the sine in float64, at the very argument.
"""

import hashlib
import re

import numpy as np
from asking import run_text

from warp_bounding.kernels.source import Lanes

NUMBER = """
typedef int Whole;
typedef float Raw;
struct T {
    float x; double e, s; mutable double b;  // computed; exact, within s; and within b of it
    T() : x(0.0f), e(0.0), s(0.0), b(0.0) {}
    T(float v) : x(v), e(v), s(0.0), b(0.0) {}
    T(double v) : x((float)v), e(x), s(0.0), b(0.0) {}
    T(int v) : x((float)v), e(x), s(0.0), b(0.0) {}
    T(unsigned int v) : x((float)v), e(x), s(0.0), b(0.0) {}
    static double size(double v) { return v < 0.0 ? -v : v; }
    static T made(float x, double e, double s, double b) {
        T r; r.x = x; r.e = e; r.s = s + size(e) * 0x1p-52 + 0x1p-1000;
        r.b = (b + size(x) * (0x1p-24 + 0x1p-46) + 0x1p-126) * (1.0 + 0x1p-40);
        return r;
    }
    T operator-() const { T r = *this; r.x = -x; r.e = -e; return r; }
    T operator+(T o) const { return made(x + o.x, e + o.e, s + o.s, b + o.b); }
    T operator-(T o) const { return made(x - o.x, e - o.e, s + o.s, b + o.b); }
    T operator*(T o) const {
        const double off = size(e) * o.s + size(o.e) * s + s * o.s;
        return made(x * o.x, e * o.e, off, size(x) * o.b + (size(o.x) + o.b) * b);
    }
    T operator/(T o) const {  // of operands that are exact or far from 0
        const double least = size(o.x) - o.b, q = e / o.e;
        return made(x / o.x, q, (s + size(q) * o.s) / (size(o.e) - o.s), (b + size(q) * o.b) / least);
    }
    T operator+=(T o) { return *this = *this + o; }
    T operator-=(T o) { return *this = *this - o; }
    T operator*=(T o) { return *this = *this * o; }
    bool near(const T& o) const {
        const bool same = size((double)x - o.x) <= b + o.b;
        if (same) b = o.b = b > o.b ? b : o.b;
        return same;
    }
    bool operator<(const T& o) const { near(o); return x < o.x; }
    bool operator>(const T& o) const { near(o); return x > o.x; }
    bool operator<=(const T& o) const { near(o); return x <= o.x; }
    bool operator>=(const T& o) const { near(o); return x >= o.x; }
    bool operator==(const T& o) const { near(o); return x == o.x; }
    explicit operator Whole() const { return (Whole)x; }
};
auto wb_root = [](T a) {
    const double r = sqrt(a.e), far = sqrt(a.b), close = a.e > 0.0 ? a.b / r : far;
    return T::made(sqrtf(a.x), r, r > 0.0 ? a.s / r : sqrt(a.s), far < close ? far : close);
};
auto floorf = [](T a) { return T(::floorf(a.x)); };  // which cell it is: any will do that is so near
auto wb_over = [](T a, T b) { return a / b; };
auto wb_size_of = [](T a) { return a.x < 0.0f ? -a : a; };
auto wb_most = [](T a, T b) { return a < b ? b : a; };
auto wb_least = [](T a, T b) { return b < a ? b : a; };
auto whole = [](T& q) { q.e = q.x; q.s = q.b = 0.0; };  // any whole number will do
auto finished = [](T z, T p, T q) {  // z is what the argument is, exactly or not; p the polynomial of its float32 value
    union { float f; unsigned int i; } a, b;
    a.f = p.x; b.f = q.x; a.i ^= b.i << 31;
    const double exact = sin((double)z.x), own = a.f == p.x ? p.e : -p.e;
    T r; r.x = a.f; r.e = sin(z.e); r.s = z.s + 0x1p-50;
    r.b = z.b + p.b + p.s + T::size(own - exact) + 0x1p-50;
    return r;
};
"""
FEW = 6  # numbers that are written for a query


def tracked(bounder, v: np.ndarray) -> tuple[np.ndarray, ...]:
    """Of float32 coordinates ``(N, ndim)``: f in float32; the exact f, and within what; and the derived bound of both.

    The last array tells where a number of the bounder's (a threshold of an exit) was compared with one so near that
    rounding decides which way the text goes on.
    """
    source, weights, words = bounder.source, bounder.weights(), bounder.words()
    body = source.body(Lanes(vector=False))
    body = re.sub(r"union \{.*?h = a_\.f;", "h = finished(z_, p_, q_);", body)
    body = body.replace("V z_ = s[r];", "V z_ = s[r]; z_.e = z_.x; z_.s = z_.b = 0.0;")
    body = body.replace("finished(z_,", "finished(s[r],")
    body = body.replace("V n_ =", "whole(q_); V n_ =")
    body = re.sub(r"(?<![\w.])((?:0x[\da-f.]+p[+-]?\d+|\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)f)\b", r"V(\1)", body)
    body = re.sub(r"\bfloat\b", "V", body)
    body = re.sub(r"(union \{[^}]*)\bV f;", r"\1Raw f;", body)
    n, count = v.shape[1], len(weights)
    numbers = np.concatenate([weights, bounder.domain.limit]).astype(np.float32)
    text = f"""
#if !defined(__CUDA_ARCH__)
#pragma clang fp contract(off)
{NUMBER}
typedef T V; typedef bool Mask;
V f, v[{n}], held[{len(numbers)}]; const V zero = V(), *w = held, *limit = held + {count};
enum {{ N = {n} }}; (void)w; (void)limit; (void)zero;
static const unsigned int WORDS[] = {{{", ".join(f"{int(word)}u" for word in words)}}};
struct {{ const unsigned int* data; }} words = {{WORDS}}; (void)words;
for (int k = 0; k < N; ++k) v[k] = V(x.data[(long long)block * N + k]);
for (int k = 0; k < {len(numbers)}; ++k) held[k] = V(numbers.data[k]);
{{ {body} }}
bool doubt = false;
for (int k = 0; k < {count}; ++k) doubt = doubt || held[k].b > 0.0;
float* row = out.data + (long long)block * {FEW};
row[0] = f.x; row[1] = (float)f.e; row[2] = (float)(f.e - row[1]);
row[3] = f.s > 0.0 ? (float)f.s + 0x1p-126f : 0.0f; row[4] = (float)f.b; row[5] = doubt;
#endif
"""
    name = f"wb_tracked_{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    found = run_text(name, text, len(v), v, numbers, (len(v), FEW))
    computed, high, low, within, derived = found.astype(np.float64).T[:5]
    within = within * (1 + 2.0**-20) + np.abs(low) * 2.0**-24  # what is lost of it as two float32 numbers
    return computed, high + low, within, derived * (1 + 2.0**-20), found[:, 5] > 0
