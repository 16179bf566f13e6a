// A bounder as one header for C99, C++ and CUDA, for bounders/export.py: what stands around the same text of f that
// Warp compiles. Every header has HEAD and NUMBERS. Names behind $ are filled in there.

/// HEAD:
#ifndef $NAME_H
#define $NAME_H

#if defined(__FAST_MATH__) || defined(_M_FP_FAST) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "$name: the proof is about IEEE arithmetic, which -ffast-math gives up; leave it out"
#endif
#if defined(__FLT_EVAL_METHOD__) && __FLT_EVAL_METHOD__ != 0 && __FLT_EVAL_METHOD__ != 16
#error "$name: the proof is about float32 and float64; this compiler computes in others (on x86: -msse2 -mfpmath=sse)"
#endif
#if defined(__STRICT_ANSI__) && defined(__cplusplus) && __cplusplus < 201703L && !defined(__clang__)
#error "$name: hexadecimal numbers need -std=gnu++11, -std=c++17, or a later one"
#endif
#if !defined(__CUDACC_RTC__)
#include <math.h>
#elif !defined(INFINITY)
#define INFINITY ((float)(1e300 * 1e300))
#endif

#ifndef WB_FUNCTION
#if defined(__CUDACC__)
#define WB_FUNCTION __host__ __device__ static inline
#else
#define WB_FUNCTION static inline
#endif
#if defined(__CUDA_ARCH__)
WB_FUNCTION float wb_root(float x) { return __fsqrt_rn(x); }
WB_FUNCTION float wb_over(float a, float b) { return __fdiv_rn(a, b); }
#else
WB_FUNCTION float wb_root(float x) { return sqrtf(x); }
WB_FUNCTION float wb_over(float a, float b) { return a / b; }
#endif
WB_FUNCTION float wb_size_of(float x) { return fabsf(x); }
WB_FUNCTION float wb_most(float a, float b) { return a > b ? a : b; }
WB_FUNCTION float wb_least(float a, float b) { return a < b ? a : b; }
#endif

/// NUMBERS
WB_FUNCTION const $kind *${name}_$what(void) {
    static const $kind numbers[] = {$numbers};
    return numbers;
}

/// BEGIN:
/// What every function reads.
typedef float V;
typedef int Mask;
enum { N = $n };
const struct { const float *data; } parameters = {${name}_numbers()};
const struct { const unsigned int *data; } words = {${name}_words()};
const float zero = 0.0f;
(void)words, (void)zero, (void)(Mask)0;
$parts

/// MAYBE:
// Whether a $kind query, $columns numbers as `query` takes them, may meet the object: 1 maybe, 0 certainly not.
WB_FUNCTION int ${name}_maybe(const float q[$columns]) {
    $begin
    float v[$coordinates];
    $locate
    if (!testable) return 1;
    if (!inside) return 0;
    V f;
    $scalar_body
    return !(f < threshold);
}

// The answers to count queries, one after another: 1 maybe, 0 no.
WB_FUNCTION void ${name}_maybe_many(const float *q, int count, unsigned char *answers) {
    for (int i = 0; i < count; ++i) answers[i] = (unsigned char)${name}_maybe(q + $columns * i);
}

/// DISTANCE:
// A lower bound of the distance from a point to the object, never below 0.
WB_FUNCTION float ${name}_distance(const float q[$n]) {
    $begin
    float v[$coordinates];
    $locate
    V f;
    $scalar_body
    $after
    return g;
}

// Whether a point may be within a radius of the object: 0 only if it is certainly farther away.
WB_FUNCTION int ${name}_within(const float q[$n], float radius) { return !(${name}_distance(q) > radius); }

// Whether a ball of a radius may touch the object on its way from a to b: 0 only if it certainly does not.
WB_FUNCTION int ${name}_segment(const float a[$n], const float b[$n], float radius) {
    $begin
    (void)threshold, (void)share, (void)scale;
    $way
    $span
    const int steps = $steps;
    float t = begins;
    const float last = ends;
    $march
    return !clear;
}

/// PAIR:
// A lower bound of the distance between two placed and scaled meshes, negative where nothing is known. A place is seven
// numbers: position, and quaternion x, y, z, w. Where not exact, all that is asked is whether it is above the gap.
WB_FUNCTION float ${name}_closest(const float place_a[7], const float place_b[7], const float scale_a[3],
const float scale_b[3], float gap, int exact) {
    $begin
    const struct { const float *data; } slots = {${name}_slots()};
    const struct { const int *data; } links = {${name}_links()};
    const int groups = $groups;
    $search
}

// Whether two placed meshes may be within a gap: 0 only if they are certainly farther apart.
WB_FUNCTION int ${name}_maybe(const float place_a[7], const float place_b[7], float gap) {
    const float one[3] = {1.0f, 1.0f, 1.0f};
    return !(${name}_closest(place_a, place_b, one, one, gap, 0) > gap);
}

// A lower bound of the distance between two placed meshes, never below 0.
WB_FUNCTION float ${name}_distance(const float place_a[7], const float place_b[7]) {
    const float one[3] = {1.0f, 1.0f, 1.0f};
    return wb_most(${name}_closest(place_a, place_b, one, one, INFINITY, 1), 0.0f);
}
