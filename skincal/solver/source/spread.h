/* How errors that many pokes share spread to taxels and modules: drift, the skin's thickness, errors of the rig, the height of a
 * module over its mesh.
 *
 * The mathematics stands above `skincal/taxels/shared_errors.py` and `skincal/modules/off_surface.py`. A taxel's or a module's
 * numbers depend on its own pokes alone, in the order of their numbers.
 */
#ifndef SPREAD_H
#define SPREAD_H

#include "modules.h"
#include "uncertainty.h"

/* Normal equations of a taxel or a module with d unknowns, from pokes in the order of their numbers. */
typedef struct {
    int count, d, errors, pose_errors;
    const int *pokes, *poses;
    const Vec (*pairs)[2];      /* E */
    const Vec *normals;         /* unit, outward, of the skin; zero if unknown */
    const double *weights;      /* (count, d, 2) of the two rows in the equations of the unknowns */
    const double *inverse;      /* (d, d) of the information */
    const double *alike, *of_pose; /* (count, 2, errors) and (count, 2, pose_errors), metres */
    double slow;                /* metres^2, each direction: variance of slow errors */
    const SpreadRules *rules;
} Equations;

static double *zeros(int count)
{
    double *values = ROOM(double, count);
    for (int i = 0; i < count; i++) values[i] = 0.0;
    return values;
}

/* The inverse of a symmetric matrix without negative values, (d, d); zero along directions that are not determined. */
static void invert(const double *a, int d, double least, double *inverse)
{
    double root[UNKNOWNS][WIDE] = {0}, firm[UNKNOWNS], most = 0.0;
    for (int i = 0; i < d; i++)
        for (int j = 0; j < d; j++) {
            root[i][j] = a[d * i + j];
            inverse[d * i + j] = 0.0;
        }
    /* S V' of a = V S V'. */
    make_orthogonal(root, d);
    for (int k = 0; k < d; k++) {
        firm[k] = root_of(inner(root[k], root[k], d));
        most = larger(most, firm[k]);
    }
    for (int k = 0; k < d; k++) {
        if (!(firm[k] > least * most)) continue;
        for (int i = 0; i < d; i++)
            for (int j = 0; j < d; j++) inverse[d * i + j] += root[k][i] / firm[k] * (root[k][j] / firm[k]) / firm[k];
    }
}

/* The variance of slow errors from the misses, metres, times trust: the mean product of successive ones less its standard error. */
static double slow_variance(const Equations *e, const double (*misses)[2], int corrected)
{
    double product = 0, squares = 0, shared = 0;
    for (int step = 1; step <= 2; step++)
        for (int i = 0; i + step < e->count; i++) {
            int j = i + step;
            if (e->poses[i] != e->poses[j] || e->pokes[j] - e->pokes[i] > e->rules->max_drift_pair_gap) continue;
            const Vec *a = e->pairs[i], *b = e->pairs[j];
            double along = dot(plus(times(misses[i][0], a[0]), times(misses[i][1], a[1])),
                               plus(times(misses[j][0], b[0]), times(misses[j][1], b[1])));
            product += along;
            squares += along * along;
            /* trace P_i P_j, with P = E'E = 1 - u u'. */
            shared += 1.0 + square(dot(cross(a[0], a[1]), cross(b[0], b[1])));
        }
    double seen = shared > 0 ? larger(product - root_of(squares), 0.0) / shared : 0.0;
    return corrected ? e->rules->drift_factor_if_corrected * seen : seen;
}

INLINE Vec row_pull(const Equations *e, int i, int j)
{
    const double *weight = e->weights + 2 * (i * e->d + j);
    return plus(times(weight[0], e->pairs[i][0]), times(weight[1], e->pairs[i][1]));
}

/* Returns `inverse` middle `inverse`, (d, d). */
static double *between(const Equations *e, const double *middle)
{
    int d = e->d;
    double *half = zeros(d * d), *whole = zeros(d * d);
    for (int i = 0; i < d; i++)
        for (int k = 0; k < d; k++)
            for (int j = 0; j < d; j++) half[d * i + j] += e->inverse[d * i + k] * middle[d * k + j];
    for (int i = 0; i < d; i++)
        for (int k = 0; k < d; k++)
            for (int j = 0; j < d; j++) whole[d * i + j] += half[d * i + k] * e->inverse[d * k + j];
    return whole;
}

/* The covariance (d, d) that slow errors and the skin's thickness, sd `skin`, add to the unknowns. */
static double *of_slow_errors(const Equations *e, double skin)
{
    int d = e->d;
    double *middle = zeros(d * d), *along = zeros(d);
    Vec *together = ROOM(Vec, d);
    for (int first = 0, end; first < e->count; first = end) {
        int block = (e->pokes[first] - e->pokes[0]) / (int)e->rules->pokes_per_drift_block;
        for (int j = 0; j < d; j++) together[j] = vec(0, 0, 0);
        for (end = first; end < e->count && e->poses[end] == e->poses[first]; end++) {
            if ((e->pokes[end] - e->pokes[0]) / (int)e->rules->pokes_per_drift_block != block) break;
            for (int j = 0; j < d; j++) {
                Vec pull = row_pull(e, end, j);
                together[j] = plus(together[j], pull);
                along[j] += dot(pull, e->normals[end]);
            }
        }
        for (int i = 0; i < d; i++)
            for (int j = 0; j < d; j++) middle[d * i + j] += dot(together[i], together[j]);
    }
    for (int i = 0; i < d; i++)
        for (int j = 0; j < d; j++) middle[d * i + j] = e->slow * middle[d * i + j] + square(skin) * along[i] * along[j];
    return between(e, middle);
}

/* The covariance (d, d) by errors that the pokes of one arm pose share, independent between poses. */
static double *of_pose_errors(const Equations *e)
{
    int d = e->d, wide = e->pose_errors, *order = ROOM(int, e->count);
    double *middle = zeros(d * d), *together = ROOM(double, d * wide);
    order_by_pose(e->poses, e->count, order);
    for (int first = 0, end; first < e->count; first = end) {
        for (int k = 0; k < d * wide; k++) together[k] = 0.0;
        for (end = first; end < e->count && e->poses[order[end]] == e->poses[order[first]]; end++)
            for (int j = 0; j < d; j++)
                for (int r = 0; r < 2; r++) {
                    double weight = e->weights[2 * (order[end] * d + j) + r];
                    const double *shift = e->of_pose + (2 * order[end] + r) * wide;
                    for (int k = 0; k < wide; k++) together[wide * j + k] += weight * shift[k];
                }
        for (int i = 0; i < d; i++)
            for (int j = 0; j < d; j++)
                for (int k = 0; k < wide; k++) middle[d * i + j] += together[wide * i + k] * together[wide * j + k];
    }
    return between(e, middle);
}

/* The shifts (d, errors) of the unknowns by errors that all pokes share. */
static double *shifts_of(const Equations *e)
{
    int d = e->d, wide = e->errors;
    double *pulled = zeros(d * wide), *shifts = zeros(d * wide);
    for (int i = 0; i < e->count; i++)
        for (int j = 0; j < d; j++)
            for (int r = 0; r < 2; r++) {
                double weight = e->weights[2 * (i * d + j) + r];
                for (int k = 0; k < wide; k++) pulled[wide * j + k] += weight * e->alike[(2 * i + r) * wide + k];
            }
    for (int i = 0; i < d; i++)
        for (int j = 0; j < d; j++)
            for (int k = 0; k < wide; k++) shifts[wide * i + k] -= e->inverse[d * i + j] * pulled[wide * j + k];
    return shifts;
}

/* `variance_factors` of `shared_errors.py`: of squared misses, in standard deviations, whose sum by trust is `found`. */
static double variance_factor(double found, double trusts, double unknowns)
{
    double freedom = larger(2.0 * trusts - unknowns, 1.0), seen = found / freedom - root_of(2.0 / freedom);
    return seen > 1.0 ? seen * freedom / larger(freedom - 2.0, 1.0) : 1.0;
}

/* ---- taxels ---- */

/* Answers of a taxel, in the order of their pokes' numbers. */
typedef struct {
    int count, d;
    Vec p, normal, free[3];     /* position, the skin's normal, and the d directions in which it is free */
    const int *at;              /* the answers, by number */
    double *shares;             /* trust times squared weight */
    double *offsets;            /* metres^2 */
} Taxel;

INLINE Vec answer_column(const TaxelSpread *q, int first, int answer)
{
    const double *c = q->columns + (Word)first * q->answers + answer;
    return vec(c[0], c[q->answers], c[2 * q->answers]);
}

static Taxel taxel_of(const TaxelSpread *q, int t)
{
    int begin = q->starts[t], count = q->starts[t + 1] - begin, *at = ROOM(int, count);
    Taxel x = {.count = count, .d = q->on_surface ? 2 : 3, .p = vec_at(q->positions + 3 * t), .normal = vec_at(q->normals + 3 * t)};
    double *numbers = ROOM(double, count);
    for (int i = 0; i < count; i++) numbers[i] = q->pokes[begin + i];
    sort_by(numbers, count, at);
    x.shares = ROOM(double, count);
    x.offsets = ROOM(double, count);
    for (int i = 0; i < count; i++) {
        at[i] += begin;
        x.shares[i] = q->trust[at[i]] * square(q->weights[at[i]]);
        x.offsets[i] = square(q->noise->contact) - square(q->noise->reach) * ln(q->weights[at[i]]);
    }
    x.at = at;
    for (int k = 0; k < 3; k++) x.free[k] = vec(k == 0, k == 1, k == 2);
    if (q->on_surface) across(x.normal, &x.free[0], &x.free[1]);
    return x;
}

/* The ratio of a taxel's variance to that by the scene's noise. */
static double taxel_factor(const TaxelSpread *q, const Taxel *x)
{
    const double *forces = q->columns + 6 * q->answers;
    double found = 0, trusts = 0;
    for (int i = 0; i < x->count; i++) {
        Vec first = answer_column(q, 11, x->at[i]), second = answer_column(q, 14, x->at[i]);
        Vec lever = minus(x->p, answer_column(q, 8, x->at[i])), away = minus(answer_column(q, 3, x->at[i]), x->p);
        double force = forces[x->at[i]], relative = q->noise->force / force, off[2] = {dot(first, away), dot(second, away)};
        double even = square(q->noise->moment / force) + square(relative) * dot(lever, lever) + x->offsets[i];
        double less[2] = {-relative * dot(second, lever), relative * dot(first, lever)};
        /* (even I - l l')^-1 = (I + l l'/(even - l'l)) / even. */
        double along = less[0] * off[0] + less[1] * off[1], rest = even - (square(less[0]) + square(less[1]));
        found += q->trust[x->at[i]] * ((square(off[0]) + square(off[1]) + square(along) / rest) / even);
        trusts += q->trust[x->at[i]];
    }
    return variance_factor(found, trusts, x->d);
}

/* Adds to a covariance (3, 3) what answers do that are unranked: the pressed taxel is any of those at the end of the range. At a rim
 * these lie to one side, so more pokes do not move the estimate nearer to its taxel: a share of the mean square distance of the
 * pokes' axes stays. One poke has no distance from itself: its answer has the height that the scene's reach lets expect. */
static void add_unranked(const TaxelSpread *q, const Taxel *x, double covariance[9])
{
    double shift[9] = {0}, single[9] = {0}, whole = 0;
    int some = 0;
    for (int i = 0; i < x->count; i++) {
        whole += x->shares[i];
        if (!q->unranked[x->at[i]]) continue;
        some++;
        Vec first = answer_column(q, 11, x->at[i]), second = answer_column(q, 14, x->at[i]);
        Vec far = minus(answer_column(q, 3, x->at[i]), x->p), away = plus(times(dot(first, far), first), times(dot(second, far), second));
        for (int k = 0; k < 9; k++) {
            shift[k] += x->shares[i] * away.at[k / 3] * away.at[k % 3];
            single[k] += x->shares[i] * (first.at[k / 3] * first.at[k % 3] + second.at[k / 3] * second.at[k % 3]);
        }
    }
    if (!some) return;
    for (int k = 0; k < 9; k++)
        covariance[k] += (square(q->rules->unranked_shift) * shift[k] + square(q->noise->reach) * single[k] / some) / whole;
}

INLINE Vec by_inverse(const Equations *e, Vec v)
{
    Matrix inverse = matrix_at(e->inverse);
    return apply(&inverse, v);
}

static void add_outer(double covariance[9], Vec v)
{
    for (int k = 0; k < 9; k++) covariance[k] += v.at[k / 3] * v.at[k % 3];
}

/* Adds to the covariance (3, 3) of the free method its biases: by the skin's bend for larger offsets (beta of `uncertainty.h`, which
 * is proportional to their variance, so that beta beta' grows with the square of its factor), and by the noise of the forces. */
static void add_biases(const TaxelSpread *q, const Taxel *x, const Equations *e, double factor, double covariance[9])
{
    const double *forces = q->columns + 6 * q->answers;
    Vec bend = vec(0, 0, 0), pull = vec(0, 0, 0);
    double lean = 0, whole = 0;
    for (int i = 0; i < x->count; i++) {
        Vec u = answer_column(q, 0, x->at[i]), first = e->pairs[i][0], second = e->pairs[i][1];
        double out[2] = {dot(first, x->normal), dot(second, x->normal)}, noise = square(q->noise->force / forces[x->at[i]]);
        double far = x->shares[i] * x->offsets[i] * dot(u, x->normal);
        lean += x->shares[i] * ((square(out[0]) + square(out[1])) / 2.0 + noise);
        whole += x->shares[i];
        bend = plus(bend, times(far, plus(times(out[0], first), times(out[1], second))));
        pull = plus(pull, times(2.0 * x->shares[i] * noise * dot(u, minus(x->p, answer_column(q, 8, x->at[i]))), u));
    }
    double size = lean > 0 ? whole / lean / (2.0 * q->noise->radius) : 0.0;
    add_outer(covariance, times(root_of(factor * (factor - 1.0)) * size, by_inverse(e, bend)));
    add_outer(covariance, by_inverse(e, pull));
}

/* Adds `F' inner F` to a covariance (3, 3), with the d directions F. */
static void add_turned(const Taxel *x, const double *inside, double covariance[9])
{
    for (int k = 0; k < 9; k++)
        for (int i = 0; i < x->d; i++)
            for (int j = 0; j < x->d; j++) covariance[k] += x->free[i].at[k / 3] * inside[x->d * i + j] * x->free[j].at[k % 3];
}

/* The shifts (3, errors) of the taxel, and their part of the covariance. */
static void add_shifts(const TaxelSpread *q, const Taxel *x, const double *inside, double *moved, double covariance[9])
{
    int wide = (int)q->errors;
    for (int k = 0; k < 3; k++)
        for (int n = 0; n < wide; n++) {
            moved[wide * k + n] = 0.0;
            for (int i = 0; i < x->d; i++) moved[wide * k + n] += x->free[i].at[k] * inside[wide * i + n];
        }
    for (int k = 0; k < 9; k++)
        for (int n = 0; n < wide; n++) covariance[k] += moved[wide * (k / 3) + n] * moved[wide * (k % 3) + n];
}

/* Writes the worst direction, its sd and the predicted error of a covariance (3, 3). */
static void put_errors(const double covariance[9], double *worst, double *sd, double *rms)
{
    double copy[3][3], direction[3];
    for (int k = 0; k < 9; k++) copy[k / 3][k % 3] = covariance[k];
    *sd = root_of(largest_of(copy, 3, direction));
    *rms = root_of(covariance[0] + covariance[4] + covariance[8]);
    put(worst, unsigned_line(vec_at(direction)));
}

static void spread_taxel(const TaxelSpread *q, int t)
{
    Taxel x = taxel_of(q, t);
    int n = x.count, d = x.d, begin = q->starts[t];
    Vec (*pairs)[2] = (Vec (*)[2])room(sizeof(Vec[2]) * (unsigned long)n), *normals = ROOM(Vec, n);
    int *pokes = ROOM(int, n), *poses = ROOM(int, n);
    double *weights = ROOM(double, 2 * d * n), (*misses)[2] = (double (*)[2])room(sizeof(double[2]) * (unsigned long)n);
    double held[9] = {0}, inverse[9], covariance[9] = {0}, *given = q->covariances + 9 * t;
    for (int i = 0; i < n; i++) {
        Vec away = minus(answer_column(q, 3, x.at[i]), x.p);
        pokes[i] = q->pokes[x.at[i]];
        poses[i] = q->poses[x.at[i]];
        normals[i] = x.normal;
        for (int r = 0; r < 2; r++) {
            pairs[i][r] = answer_column(q, 11 + 3 * r, x.at[i]);
            misses[i][r] = q->trust[x.at[i]] * dot(pairs[i][r], away);
            for (int j = 0; j < d; j++) {
                double weight = weights[2 * (i * d + j) + r] = x.shares[i] * dot(x.free[j], pairs[i][r]);
                for (int k = 0; k < d; k++) held[d * j + k] += weight * dot(pairs[i][r], x.free[k]);
            }
        }
    }
    invert(held, d, q->rules->min_information_ratio, inverse);
    Equations e = {
        n, d, (int)q->errors, (int)q->pose_errors, pokes, poses, (const Vec (*)[2])pairs, normals, weights, inverse,
        q->alike + (Word)begin * 2 * q->errors, q->of_pose + (Word)begin * 2 * q->pose_errors, 0, q->rules,
    };
    e.slow = slow_variance(&e, (const double (*)[2])misses, (int)q->corrected);
    double factor = taxel_factor(q, &x), unranked[9] = {0}, along[4] = {0};
    add_turned(&x, of_slow_errors(&e, q->rules->skin), covariance);
    add_unranked(q, &x, unranked);
    if (d == 3) {
        for (int k = 0; k < 9; k++) covariance[k] += unranked[k];
        add_biases(q, &x, &e, factor, covariance);
    } else {
        for (int k = 0; k < 4; k++)
            for (int m = 0; m < 9; m++) along[k] += x.free[k / 2].at[m / 3] * unranked[m] * x.free[k % 2].at[m % 3];
        add_turned(&x, along, covariance);
    }
    if (q->corrected) {
        add_turned(&x, of_pose_errors(&e), covariance);
        add_shifts(q, &x, shifts_of(&e), q->moved + (Word)t * 3 * q->errors, covariance);
    }
    for (int k = 0; k < 9; k++) given[k] = factor * given[k] + covariance[k];
    put_errors(given, q->worst + 3 * t, q->sds + t, q->rms + t);
}

/* ---- modules ---- */

/* The variance of a module's height over its surface, metres^2; 0 if its pokes show none. `off_surface.py` has the mathematics. */
static double height_variance(const ModuleSpread *q, const Equations *e, int begin, double factor)
{
    const HeightRules *rules = q->heights_by;
    int d = e->d;
    double *pull = zeros(d), *along = zeros(d), *lifts = ROOM(double, 2 * e->count), known = 0, most = 0, height = 0;
    for (int i = 0; i < e->count; i++)
        for (int j = 0; j < d; j++) pull[j] += dot(row_pull(e, i, j), e->normals[i]);
    for (int i = 0; i < d; i++)
        for (int j = 0; j < d; j++) along[i] += e->inverse[d * i + j] * pull[j];
    for (int i = 0; i < e->count; i++) {
        const double *slopes = q->slopes + 2 * d * (begin + i), *misses = q->misses + 2 * (begin + i), *w = q->whiten + 4 * (begin + i);
        double trust = q->trust[begin + i], alone[2], out[2] = {dot(e->pairs[i][0], e->normals[i]), dot(e->pairs[i][1], e->normals[i])};
        for (int r = 0; r < 2; r++) {
            double rise = w[2 * r] * out[0] + w[2 * r + 1] * out[1];
            alone[r] = trust * (rise - inner(slopes + d * r, along, d));
            known += alone[r] * rise;
            most += trust * rise * rise;
            height += alone[r] * misses[r];
        }
        lifts[2 * i] = alone[0] * w[0] + alone[1] * w[2];
        lifts[2 * i + 1] = alone[0] * w[1] + alone[1] * w[3];
    }
    if (!(known > rules->min_information_share * most)) return 0.0;
    double inverse = 1.0 / known, white = factor / known, variance = white;
    Equations lifted = *e;
    lifted.d = 1;
    lifted.weights = lifts;
    lifted.inverse = &inverse;
    height /= known;
    height = smaller(height, larger(height - rules->subtracted_skin_sds * q->rules->skin, 0.0));
    variance += *of_slow_errors(&lifted, 0.0);
    if (q->corrected) {
        const double *moves = shifts_of(&lifted);
        variance += inner(moves, moves, e->errors) + *of_pose_errors(&lifted);
    }
    int seen = white < square(rules->max_sd) && square(height) > square(rules->significant_sds) * variance;
    return seen ? square(height) - variance : 0.0;
}

static void spread_module(const ModuleSpread *q, int g)
{
    int begin = q->starts[g], n = q->starts[g + 1] - begin, d = (int)q->unknowns;
    double *weights = ROOM(double, 2 * d * n), (*misses)[2] = (double (*)[2])room(sizeof(double[2]) * (unsigned long)n);
    double *inverse = q->inverses + d * d * g, *added = q->added + d * d * g, found = 0, trusts = 0;
    Vec (*pairs)[2] = (Vec (*)[2])room(sizeof(Vec[2]) * (unsigned long)n), *normals = ROOM(Vec, n);
    for (int i = 0; i < n; i++) {
        const double *slopes = q->slopes + 2 * d * (begin + i), *w = q->whiten + 4 * (begin + i), *miss = q->misses + 2 * (begin + i);
        /* Back from standard deviations to metres. */
        double trust = q->trust[begin + i], first = miss[0] / w[0], far[2] = {first, (miss[1] - w[2] * first) / w[3]};
        for (int j = 0; j < d; j++)
            for (int r = 0; r < 2; r++) weights[2 * (i * d + j) + r] = trust * slopes[j] * w[r] + trust * slopes[d + j] * w[2 + r];
        for (int r = 0; r < 2; r++) {
            const double *across = q->columns + (Word)(11 + 3 * r) * q->rows + begin + i;
            pairs[i][r] = vec(across[0], across[q->rows], across[2 * q->rows]);
            misses[i][r] = trust * far[r];
        }
        normals[i] = vec_at(q->normals + 3 * (begin + i));
        found += trust * (square(miss[0]) + square(miss[1]));
        trusts += trust;
    }
    if (!q->given) {
        double *information = zeros(d * d);
        for (int i = 2 * begin; i < 2 * (begin + n); i++)
            for (int j = 0; j < d; j++)
                for (int k = 0; k < d; k++)
                    information[d * j + k] += q->trust[i / 2] * q->slopes[d * i + j] * q->slopes[d * i + k];
        invert(information, d, q->rules->min_information_ratio, inverse);
        q->factors[g] = variance_factor(found, trusts, d);
    }
    Equations e = {
        n, d, (int)q->errors, (int)q->pose_errors, q->pokes + begin, q->poses + begin, (const Vec (*)[2])pairs, normals, weights, inverse,
        q->alike + (Word)begin * 2 * q->errors, q->of_pose + (Word)begin * 2 * q->pose_errors, 0, q->rules,
    };
    e.slow = slow_variance(&e, (const double (*)[2])misses, (int)q->corrected);
    const double *slow = of_slow_errors(&e, q->rules->skin), *of_poses = q->corrected ? of_pose_errors(&e) : zeros(d * d);
    for (int k = 0; k < d * d; k++) added[k] = slow[k] + of_poses[k];
    if (q->corrected) {
        const double *moves = shifts_of(&e);
        for (int k = 0; k < d * e.errors; k++) q->moves[d * e.errors * g + k] = moves[k];
    }
    q->heights[g] = q->heights_by ? height_variance(q, &e, begin, q->factors[g]) : 0.0;
}

#endif
