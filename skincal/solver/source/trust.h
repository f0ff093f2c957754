/* How far each contact counts for a taxel: fully, unless it is far off what the taxel's other contacts say.
 *
 * A poke that touches two places gives one axis between them, off both by millimetres to centimetres, and a pitch (eq. 3).
 * So a contact's miss z is that of its axis from where the other axes put the taxel and its pitch, each in standard
 * deviations of the rig's noise,
 *
 *     z^2 = r' D^-1 r / spread^2 + pitch^2 / (sigma_pitch^2 spread_pitch^2),
 *
 * with r the two rows' residuals and D their covariance (`uncertainty.h`). A rig whose matrix or poses are wrong misses by
 * more than its noise, and must not lose its pokes for that: the spreads are the geometric means of the taxel's own misses
 * over those of noise alone, and at least 1. (A geometric mean needs no sorting, and a few far misses hardly move it; nor do
 * very small ones, which are raised to a share of the usual one first.)
 *
 * Up to FULL_TRUST_SDS a contact counts fully, so that without outliers the estimate is that of (5); from ZERO_TRUST_SDS on not at all; in
 * between by a smooth step. The point from which r counts is found by least squares, then by STEPS steps with weights
 * 1/z^2. With few contacts, or where hardly one would be left, none can be shown to be wrong.
 *
 * It does not see a second touch that moves the axis by no more than the noise does.
 */
#ifndef TRUST_H
#define TRUST_H

#include "contacts.h"

/* Steps of that search; a second one takes 2 % off the worst taxel's error. */
static const int STEPS = 1;
/* Share of the weights that holds a step back where nearly parallel axes do not determine one: those of 0.6 degrees
 * spread. */
static const double DAMPING = 1e-4;
/* Share of a spread's square below which a squared miss counts as that: one miss of zero may not decide. */
static const double RAISED = 0.1;
/* Means of ln max(x, RAISED) for x of chi-square, of two degrees of freedom and of one: by numerical integration. */
static const double USUAL_MISS = 0.1653, USUAL_PITCH = -0.7685;

/* How far a poke counts, by the square of its miss in standard deviations. */
INLINE double trust_at(double squared)
{
    double rest = smaller(larger((ZERO_TRUST_SDS - root_of(squared)) / (ZERO_TRUST_SDS - FULL_TRUST_SDS), 0.0), 1.0);
    return squared > square(FULL_TRUST_SDS) ? rest * rest * (3.0 - 2.0 * rest) : 1.0;
}

/* A symmetric system of weighted least squares, summed up. */
typedef struct { double xx, xy, xz, yy, yz, zz; Vec pull; } Pulls;

INLINE void pull(Pulls *s, double weight, Vec row, double residual)
{
    Vec w = times(weight, row);
    s->xx += w.x * row.x;
    s->xy += w.x * row.y;
    s->xz += w.x * row.z;
    s->yy += w.y * row.y;
    s->yz += w.y * row.z;
    s->zz += w.z * row.z;
    s->pull = plus(s->pull, times(residual, w));
}

/* The step to the minimum, held back by DAMPING; by Cholesky's factors, whose pivots that keeps above zero. */
static Vec step_of(const Pulls *s)
{
    double held = DAMPING * (s->xx + s->yy + s->zz);
    double d1 = s->xx + held, l21 = s->xy / d1, l31 = s->xz / d1;
    double d2 = s->yy + held - l21 * s->xy, m32 = s->yz - l31 * s->xy, l32 = m32 / d2;
    double d3 = s->zz + held - l31 * s->xz - l32 * m32;
    double y1 = s->pull.x, y2 = s->pull.y - l21 * y1, y3 = s->pull.z - l31 * y1 - l32 * y2;
    double z = y3 / d3, y = y2 / d2 - l32 * z;
    return vec(y1 / d1 - l21 * y - l31 * z, y, z);
}

/* Both rows of each contact and the square of its pitch, in standard deviations of the noise. */
typedef struct { Vec *first, *second; double *pitch; } Whitened;

/* The geometric mean of max(x, least): of a product whose power of two is kept apart, so that it takes one logarithm. */
static double geometric_mean(const double *squares, int count, double least)
{
    double product = 1.0;
    int exponent = 0, more;
    for (int i = 0; i < count; i++) {
        product *= fraction(larger(squares[i], least), &more);
        exponent += more;
        if (product < 0x1p-500) {
            product = fraction(product, &more);
            exponent += more;
        }
    }
    return power_of_e((ln(product) + exponent * 0.69314718055994531) / count);
}

/* Squared misses over what is usual for the taxel, where that is more than the noise. */
static void make_relative(double *squares, int count, double usual)
{
    /* Raised first to a share of what the noise makes, then to one of what is found. */
    double wide = larger(geometric_mean(squares, count, RAISED) * power_of_e(-usual), 1.0);
    int freedom = 2 * count - 3 > 1 ? 2 * count - 3 : 1;
    wide = geometric_mean(squares, count, RAISED * wide) * power_of_e(-usual) * (1.0 + SMALL_SAMPLE_SPREAD_CORRECTION / freedom);
    if (wide < 1.0) wide = 1.0;
    for (int i = 0; i < count; i++) squares[i] /= wide;
}

/* The rows in standard deviations for a taxel near p: D = L L' with L lower triangular, the rows are those of L^-1. */
static Whitened whiten(const Contacts *c, Vec p, const Noise *noise)
{
    Whitened w = {ROOM(Vec, c->count), ROOM(Vec, c->count), ROOM(double, c->count)};
    Vec normal = along_push(c);
    for (int i = 0; i < c->count; i++) {
        Vec first = column(c->first, i), second = column(c->second, i);
        RowNoise n = sensor_noise(c, i, p, noise);
        double beside = c->square[i], out[2] = {dot(first, normal), dot(second, normal)};
        double even = n.even + beside;
        double l11 = root_of(even - square(n.less[0]) - beside * square(out[0]));
        double l21 = -(n.less[0] * n.less[1] + beside * out[0] * out[1]) / l11;
        double l22 = root_of(even - square(n.less[1]) - beside * square(out[1]) - l21 * l21);
        w.first[i] = times(1.0 / l11, first);
        w.second[i] = times(1.0 / l22, minus(second, times(l21, w.first[i])));
        double pitch_square = square(noise->moment / c->force[i]) + square(n.less[0]) + square(n.less[1]);
        w.pitch[i] = square(c->pitch[i]) / pitch_square;
    }
    make_relative(w.pitch, c->count, USUAL_PITCH);
    return w;
}

/* Where least squares puts the taxel: begun from the axes' points nearest to the sensor, the same in every frame. */
static Vec begin_at(const Contacts *c, const double *shares)
{
    Vec p = vec(0, 0, 0);
    for (int i = 0; i < c->count; i++) {
        Vec nearest = column(c->nearest, i), u = column(c->u, i);
        p = plus(p, times(shares[i], plus(nearest, times(dot(u, minus(column(c->sensor, i), nearest)), u))));
    }
    Pulls sum = {0};
    for (int i = 0; i < c->count; i++) {
        Vec off = minus(column(c->nearest, i), p), first = column(c->first, i), second = column(c->second, i);
        pull(&sum, shares[i], first, dot(first, off));
        pull(&sum, shares[i], second, dot(second, off));
    }
    return plus(p, step_of(&sum));
}

/* The squared misses of the axes from p. */
INLINE double miss_square(const Contacts *c, const Whitened *w, int i, Vec p, double residuals[2])
{
    Vec off = minus(column(c->nearest, i), p);
    residuals[0] = dot(w->first[i], off);
    residuals[1] = dot(w->second[i], off);
    return square(residuals[0]) + square(residuals[1]);
}

static Vec step_from(const Contacts *c, const Whitened *w, const double *shares, Vec p)
{
    Pulls sum = {0};
    for (int i = 0; i < c->count; i++) {
        double residuals[2], squared = miss_square(c, w, i, p, residuals) + w->pitch[i];
        double share = shares[i] / larger(squared, FULL_WEIGHT_MAX_MISS_SDS * FULL_WEIGHT_MAX_MISS_SDS);
        pull(&sum, share, w->first[i], residuals[0]);
        pull(&sum, share, w->second[i], residuals[1]);
    }
    return plus(p, step_of(&sum));
}

/* Fills in the trust, exactly 1 for nearly all. It depends on the taxel's own contacts alone. */
static void find_trust(Contacts *c, const Noise *noise)
{
    for (int i = 0; i < c->count; i++) c->trust[i] = 1.0;
    if (c->count < MIN_POKES_FOR_TRUST) return;
    unsigned char *mark = top;
    double *shares = ROOM(double, c->count), *squares = ROOM(double, c->count), *trust = ROOM(double, c->count);
    double sum = 0;
    for (int i = 0; i < c->count; i++) sum += c->weight[i];
    for (int i = 0; i < c->count; i++) shares[i] = c->weight[i] / sum;
    Vec p = begin_at(c, shares);
    Whitened w = whiten(c, p, noise);
    for (int k = 0; k < STEPS; k++) p = step_from(c, &w, shares, p);
    double ignored[2], left = 0;
    for (int i = 0; i < c->count; i++) squares[i] = miss_square(c, &w, i, p, ignored);
    make_relative(squares, c->count, USUAL_MISS);
    for (int i = 0; i < c->count; i++) {
        double squared = squares[i] + w.pitch[i];
        trust[i] = trust_at(squared);
        left += trust[i];
    }
    if (!(left < MIN_SUM_OF_POKE_TRUSTS)) for (int i = 0; i < c->count; i++) c->trust[i] = trust[i];
    top = mark;
}

#endif
