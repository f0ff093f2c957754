/* The contacts of one taxel, and the noise of the rig that measured them.
 *
 * For a contact with wrench (f, m) in the link frame a taxel at p has the residual (f x p + m)/|f| = u x p + m/|f| with
 * u = f/|f|. With a = u x m/|f| the axis's point nearest to the origin and e_1, e_2 orthonormal across u,
 *
 *     |u x p + m/|f||^2 = (e_1.(p - a))^2 + (e_2.(p - a))^2 + pitch^2,
 *
 * so each contact gives two rows; `skincal/taxels/contact_table.py` says why not three.
 */
#ifndef CONTACTS_H
#define CONTACTS_H

#include "base.h"
#include "tables.h"

/* Columns, each of which runs over the contacts, the heaviest first. */
typedef struct {
    int count;
    const double *u[3];       /* f/|f| */
    const double *nearest[3]; /* a, metres */
    const double *force;      /* |f|, N */
    const double *pitch;      /* f.m/|f|^2, metres */
    const double *sensor[3];  /* where the sensor's origin is, metres */
    const double *first[3], *second[3]; /* e_1 and e_2 */
    const double *weight;     /* k, 0 < k <= 1 */
    const int *pose;          /* equal where the arm's pose is the same */
    double *trust;            /* 0 to 1 */
    double *scale;            /* k times the root of the trust, by which the rows are multiplied */
    double *weakness;         /* sqrt(ln(1/k)) */
    double *square;           /* s^2: how far the contact is beside the taxel, in each direction in the skin's plane, metres^2 */
} Contacts;

INLINE Vec column(const double *const c[3], int i) { return vec(c[0][i], c[1][i], c[2][i]); }

/* What follows from the weights alone. */
static void set_offsets(Contacts *c, const Noise *noise)
{
    for (int i = 0; i < c->count; i++) {
        /* k <= 1. */
        double less = c->weight[i] < 1.0 ? -ln(c->weight[i]) : 0.0;
        c->weakness[i] = root_of(less);
        c->square[i] = square(noise->contact) + square(noise->reach) * less;
    }
}

/* k times the root of the trust. */
static void set_scales(Contacts *c)
{
    for (int i = 0; i < c->count; i++) c->scale[i] = c->weight[i] * root_of(c->trust[i]);
}

/* The weighted mean of the directions: shorter than 1 the more they differ. */
static Vec mean_push(const Contacts *c)
{
    Vec sum = vec(0, 0, 0);
    double shares = 0;
    for (int i = 0; i < c->count; i++) {
        double share = c->weight[i] * c->trust[i];
        sum = plus(sum, times(share, column(c->u, i)));
        shares += share;
    }
    return vec(sum.x / shares, sum.y / shares, sum.z / shares);
}

/* The unit vector along the mean push; zero where pushes cancel. */
static Vec along_push(const Contacts *c)
{
    Vec push = mean_push(c);
    double size = length(push);
    return size > 0 ? vec(push.x / size, push.y / size, push.z / size) : vec(0, 0, 0);
}

/* At what distance the axes pass p, metres: the weighted root mean square. */
static double miss_of(const Contacts *c, Vec p)
{
    double sum = 0, shares = 0;
    for (int i = 0; i < c->count; i++) {
        Vec off = minus(p, column(c->nearest, i));
        double share = square(c->scale[i]);
        sum += share * (square(dot(column(c->first, i), off)) + square(dot(column(c->second, i), off)));
        shares += share;
    }
    return root_of(sum / shares);
}

/* What the noise makes of a contact's two rows, before weighting: covariance `even` I - less less', metres^2. */
typedef struct { double even, less[2]; } RowNoise;

/* From the sensor, for a taxel at p: S(q) S(q)' = |q|^2 I - q q' with the lever q, and T turns q into (e_2.q, -e_1.q); its sign
 * does not matter. */
INLINE RowNoise sensor_noise(const Contacts *c, int i, Vec p, const Noise *noise)
{
    Vec q = minus(p, column(c->sensor, i));
    double relative = noise->force / c->force[i];
    return (RowNoise){
        square(noise->moment / c->force[i]) + relative * relative * dot(q, q),
        {-relative * dot(column(c->second, i), q), relative * dot(column(c->first, i), q)},
    };
}

/* A bound of all that the noise adds: the contact's offset counts in every direction here, not in the skin's plane alone. */
INLINE RowNoise row_noise(const Contacts *c, int i, Vec p, const Noise *noise)
{
    RowNoise n = sensor_noise(c, i, p, noise);
    n.even += c->square[i];
    return n;
}

#endif
