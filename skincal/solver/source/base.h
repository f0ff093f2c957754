/* Vectors, exact-enough sums, logarithm, sorting and memory: what the solver needs, since nothing of a C library is here.
 *
 * Compiled for WebAssembly, whose arithmetic is IEEE 754 without contraction: the same bits on every machine.
 */
#ifndef BASE_H
#define BASE_H

typedef unsigned int Word;
typedef unsigned long long Bits;

#define INLINE static inline __attribute__((always_inline))

static const double INFINITE = __builtin_inf();
static const double EPS = 0x1p-52;

INLINE double root_of(double x) { return __builtin_sqrt(x); }
INLINE double size_of(double x) { return __builtin_fabs(x); }
INLINE double signed_as(double size, double sign) { return __builtin_copysign(size, sign); }
INLINE double square(double x) { return x * x; }
INLINE double larger(double a, double b) { return a > b ? a : b; }
INLINE double smaller(double a, double b) { return a < b ? a : b; }
INLINE int finite(double x) { return size_of(x) < INFINITE; }
INLINE Bits bits_of(double x) { return __builtin_bit_cast(Bits, x); }
INLINE double from_bits(Bits b) { return __builtin_bit_cast(double, b); }

/* ---- vectors ---- */

/* By name or by number: `at[i]` is the only way to a component whose number is known when it runs. */
typedef union { struct { double x, y, z; }; double at[3]; } Vec;

INLINE Vec vec(double x, double y, double z) { return (Vec){{x, y, z}}; }
INLINE Vec vec_at(const double *v) { return (Vec){{v[0], v[1], v[2]}}; }
INLINE void put(double *to, Vec v) { to[0] = v.x; to[1] = v.y; to[2] = v.z; }
INLINE Vec plus(Vec a, Vec b) { return vec(a.x + b.x, a.y + b.y, a.z + b.z); }
INLINE Vec minus(Vec a, Vec b) { return vec(a.x - b.x, a.y - b.y, a.z - b.z); }
INLINE Vec times(double s, Vec a) { return vec(s * a.x, s * a.y, s * a.z); }
INLINE double dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE double length(Vec a) { return root_of(dot(a, a)); }
INLINE Vec cross(Vec a, Vec b) { return vec(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x); }

/* Two directions across the unit u, first x second = u.
 * Duff et al., "Building an orthonormal basis, revisited", 2017: no branch on nearly parallel helpers. */
INLINE void across(Vec u, Vec *first, Vec *second)
{
    double sign = signed_as(1.0, u.z), k = -1.0 / (sign + u.z), xy = u.x * u.y * k;
    *first = vec(1.0 + sign * u.x * u.x * k, sign * xy, -sign * u.x);
    *second = vec(xy, sign + u.y * u.y * k, -u.y);
}

/* A 3 x 3 matrix by rows. */
typedef struct { Vec row[3]; } Matrix;

INLINE Vec apply(const Matrix *m, Vec p) { return vec(dot(m->row[0], p), dot(m->row[1], p), dot(m->row[2], p)); }
INLINE Matrix matrix_at(const double *m) { return (Matrix){{vec_at(m), vec_at(m + 3), vec_at(m + 6)}}; }

/* ---- sums of many numbers ---- */

/* A sum of any length that is off by a rounding of itself: what each addition loses is kept (Knuth 1998, 4.2.2). */
typedef struct { double sum, lost; } Sum;

INLINE void add(Sum *s, double x)
{
    double next = s->sum + x, back = next - s->sum;
    s->lost += (s->sum - (next - back)) + (x - back);
    s->sum = next;
}

/* Numbers added plainly before their sum is added with care: as exact, at a fraction of the time. */
#define BLOCK 32

INLINE double total_of(Sum s) { return s.sum + s.lost; }

/* ---- functions that a C library would have ---- */

/* Returns x / 2^e with 0.5 <= |x / 2^e| < 1, and e; 0 and 0 for 0. */
static double fraction(double x, int *exponent)
{
    int subnormal = 0;
    if (x == 0.0 || !finite(x)) { *exponent = 0; return x; }
    if (size_of(x) < 0x1p-1022) { x *= 0x1p54; subnormal = 54; }
    *exponent = (int)((bits_of(x) >> 52) & 0x7ff) - 1022 - subnormal;
    return from_bits((bits_of(x) & 0x800fffffffffffffull) | 0x3fe0000000000000ull);
}

/* 2^e; as near as numbers go beyond their range. */
static double power_of_two(int e)
{
    if (e > 1023) return INFINITE;
    if (e >= -1022) return from_bits((Bits)(e + 1023) << 52);
    return e < -1074 ? 0.0 : from_bits(1ull << (e + 1074));
}

static const double LN2_HIGH = 0x1.62e42feep-1, LN2_LOW = 0x1.a39ef35793c76p-33;

/* The natural logarithm: of x = 2^e m by the series of artanh((m - 1)/(m + 1)), which ends 1e-18 after ten terms. */
static double ln(double x)
{
    int e;
    if (x == 0.0) return -INFINITE;
    if (!(x > 0.0) || x == INFINITE) return x > 0.0 ? x : __builtin_nan("");
    double m = fraction(x, &e);
    if (m < 0.70710678118654752) { m *= 2.0; e -= 1; }
    double s = (m - 1.0) / (m + 1.0), z = s * s, series = 0.0;
    for (int k = 21; k >= 3; k -= 2) series = series * z + 1.0 / k;
    return e * LN2_HIGH + (2.0 * s + (2.0 * s * z * series + e * LN2_LOW));
}

/* e^x: 2^n times the series of what is left, |r| <= ln(2)/2, whose fourteenth term is 1e-17. */
static double power_of_e(double x)
{
    if (!(x < 709.0)) return x > 0.0 ? INFINITE : x;
    if (x < -745.0) return 0.0;
    int n = (int)(x * 1.4426950408889634 + (x < 0.0 ? -0.5 : 0.5));
    double r = (x - n * LN2_HIGH) - n * LN2_LOW, series = 1.0;
    for (int k = 14; k >= 1; k--) series = 1.0 + series * r / k;
    return n < -1021 ? series * power_of_two(n + 60) * 0x1p-60 : series * power_of_two(n);
}

/* ---- memory: what a call takes lies behind what Python put there, and is given back when the call ends ---- */

static unsigned char *top;

/* Makes the memory reach as far as `top`. */
static void reach(void)
{
    unsigned long have = __builtin_wasm_memory_size(0) * 65536ul, need = (unsigned long)top;
    if (need > have && __builtin_wasm_memory_grow(0, (need - have) / 65536ul + 1) == (unsigned long)-1) __builtin_trap();
}

static void *room(unsigned long bytes)
{
    unsigned char *here = top;
    top += (bytes + 15) / 16 * 16;
    reach();
    return here;
}

#define ROOM(type, count) ((type *)room(sizeof(type) * (unsigned long)(count)))

/* ---- sorting ---- */

/* Fills `order` with 0 ... count - 1 by rising key; equal keys keep their order. */
static void sort_by(const double *keys, int count, int *order)
{
    unsigned char *mark = top;
    int *from = order, *to = ROOM(int, count);
    for (int i = 0; i < count; i++) order[i] = i;
    for (int width = 1; width < count; width *= 2) {
        for (int left = 0; left < count; left += 2 * width) {
            int middle = left + width < count ? left + width : count;
            int right = left + 2 * width < count ? left + 2 * width : count;
            for (int i = left, a = left, b = middle; i < right; i++)
                to[i] = a < middle && (b >= right || !(keys[from[b]] < keys[from[a]])) ? from[a++] : from[b++];
        }
        int *other = from;
        from = to;
        to = other;
    }
    if (from != order) for (int i = 0; i < count; i++) order[i] = from[i];
    top = mark;
}

#endif
