/* The poses of modules, rigid or bent onto a surface: each module's least squares over all its pokes.
 *
 * The mathematics stands above `skincal/modules/pose_fit.py` (rows, start, search, trust) and `skincal/modules/pose.py` (pads);
 * here it is done, module by module: a module's numbers depend on its own pokes alone.
 */
#ifndef MODULES_H
#define MODULES_H

#include "factor.h"
#include "trust.h"
#include "walk.h"

enum { UNKNOWNS = 6, WIDE = UNKNOWNS + 1 };

typedef struct { Vec point, x, normal; int triangle; } Pose;

/* Where a pad or a middle lies, and how that changes with each unknown. */
typedef struct { Vec point, normal, change[UNKNOWNS]; int triangle; } Pad;

/* The whitened rows of a poke, and what they were made of (`pose_fit.py`). */
typedef struct {
    double slopes[2][UNKNOWNS], misses[2], pitch, whiten[3]; /* L^-1: first column's two, then the last */
    double distance, beside, share, swing[2], skin[2], push[2];
    Vec lever, u, pair[2];
    Pad middle;
} Row;

INLINE Vec column_at(const Touches *q, int first, int i)
{
    const double *c = q->columns + (Word)first * q->pokes + i;
    return vec(c[0], c[q->pokes], c[2 * q->pokes]);
}

/* ---- where pads lie ---- */

static Pad pad_at(const Boards *q, const Pose *at, double along, double beside)
{
    Pad pad = {.triangle = -1, .normal = at->normal};
    double lever = q->touches.rules->turn_to_length_radius;
    if (q->ground) {
        Footing end = walked(q->ground, (Footing){at->triangle, at->point, at->x}, along, beside);
        pad.triangle = end.triangle;
        pad.point = end.point;
        pad.normal = vec_at(q->ground->surface->normals + 3 * end.triangle);
        pad.change[0] = end.x;
        pad.change[1] = cross(pad.normal, end.x);
        Vec turn = minus(times(along, pad.change[1]), times(beside, end.x));
        pad.change[2] = vec(turn.x / lever, turn.y / lever, turn.z / lever);
        return pad;
    }
    Vec arm = plus(times(along, at->x), times(beside, cross(at->normal, at->x)));
    pad.point = plus(at->point, arm);
    for (int k = 0; k < 3; k++) {
        Vec axis = vec(k == 0, k == 1, k == 2);
        pad.change[k] = axis;
        pad.change[3 + k] = times(1.0 / lever, cross(axis, arm));
    }
    return pad;
}

static void put_pad(const Boards *q, int at, const Pad *pad)
{
    put(q->touches.pads + 3 * at, pad->point);
    put(q->touches.outward + 3 * at, pad->normal);
    q->under[at] = pad->triangle;
    for (Word k = 0; k < q->touches.unknowns; k++)
        for (int i = 0; i < 3; i++) q->touches.changes[(3 * at + i) * (int)q->touches.unknowns + (int)k] = pad->change[k].at[i];
}

static void lay(const Boards *q, int module, const Pose *at)
{
    for (int k = q->boards[module]; k < q->boards[module + 1]; k++) {
        Pad pad = pad_at(q, at, q->flat[2 * k], q->flat[2 * k + 1]);
        put_pad(q, k, &pad);
    }
}

/* sin(a)/a and (1 - cos(a))/a^2 of a^2; their series end beyond the last digit for turns up to four radians. */
static void turning(double square_of_angle, double *sine, double *versine)
{
    *sine = *versine = 1.0;
    for (int k = 20; k > 0; k--) {
        *sine = 1.0 - *sine * square_of_angle / (2 * k * (2 * k + 1));
        *versine = 1.0 - *versine * square_of_angle / ((2 * k + 1) * (2 * k + 2));
    }
    *versine *= 0.5;
}

INLINE Vec turned(Vec by, double sine, double versine, Vec v)
{
    Vec along = minus(times(dot(by, v), by), times(dot(by, by), v));
    return plus(v, plus(times(sine, cross(by, v)), times(versine, along)));
}

static Pose moved(const Boards *q, const Pose *from, const double move[UNKNOWNS])
{
    double sine, versine, lever = q->touches.rules->turn_to_length_radius;
    if (q->ground) {
        Footing end = walked(q->ground, (Footing){from->triangle, from->point, from->x}, move[0], move[1]);
        Vec normal = vec_at(q->ground->surface->normals + 3 * end.triangle), y = cross(normal, end.x);
        double angle = move[2] / lever;
        turning(angle * angle, &sine, &versine);
        Vec x = plus(times(1.0 - versine * angle * angle, end.x), times(sine * angle, y));
        return (Pose){end.point, x, normal, end.triangle};
    }
    Vec by = vec(move[3] / lever, move[4] / lever, move[5] / lever);
    turning(dot(by, by), &sine, &versine);
    Vec point = plus(from->point, vec(move[0], move[1], move[2]));
    return (Pose){point, turned(by, sine, versine, from->x), turned(by, sine, versine, from->normal), -1};
}

/* ---- the rows ---- */

static Pad middle_of(const Touches *q, int poke)
{
    Pad middle = {.triangle = -1};
    int d = (int)q->unknowns;
    for (int k = q->starts[poke]; k < q->starts[poke + 1]; k++) {
        int pad = q->answers[k];
        const double *change = q->changes + 3 * pad * d;
        double share = q->shares[k];
        middle.point = plus(middle.point, times(share, vec_at(q->pads + 3 * pad)));
        middle.normal = plus(middle.normal, times(share, vec_at(q->outward + 3 * pad)));
        for (int j = 0; j < d; j++)
            middle.change[j] = plus(middle.change[j], times(share, vec(change[j], change[d + j], change[2 * d + j])));
    }
    middle.normal = shortened(middle.normal);
    return middle;
}

static void row_of(const Touches *q, int i, Row *r)
{
    const double *force = q->columns + 6 * q->pokes, *pitch = q->columns + 7 * q->pokes;
    double size = force[i];
    r->middle = middle_of(q, i);
    r->u = column_at(q, 0, i);
    r->pair[0] = column_at(q, 11, i);
    r->pair[1] = column_at(q, 14, i);
    r->lever = minus(r->middle.point, column_at(q, 8, i));
    r->share = q->noise->force / size;
    r->beside = root_of(q->offsets[i]);
    double moment = square(q->noise->moment / size), out[2];
    for (int k = 0; k < 2; k++) {
        r->swing[k] = r->share * dot(r->pair[k], r->lever);
        out[k] = r->beside * dot(r->pair[k], r->middle.normal);
    }
    r->skin[0] = -out[1];
    r->skin[1] = out[0];
    r->push[0] = r->share * dot(r->u, r->lever);
    r->push[1] = r->beside * dot(r->u, r->middle.normal);
    double even = moment + (square(r->push[0]) + square(r->push[1])), *p = r->swing, *o = r->skin;
    double swung = square(p[0]) + square(p[1]), beside = square(o[0]) + square(o[1]);
    double xx = even + square(p[0]) + square(o[0]), xy = p[0] * p[1] + o[0] * o[1];
    double l11 = root_of(xx), l22 = root_of(even * (even + (swung + beside)) + square(p[0] * o[1] - p[1] * o[0])) / l11;
    r->whiten[0] = 1.0 / l11;
    r->whiten[1] = -xy / (xx * l22);
    r->whiten[2] = 1.0 / l22;
    r->pitch = square(pitch[i]) / (moment + swung);
    Vec off = minus(column_at(q, 3, i), r->middle.point);
    double far[2] = {dot(r->pair[0], off), dot(r->pair[1], off)};
    r->distance = root_of(square(far[0]) + square(far[1]));
    r->misses[0] = r->whiten[0] * far[0];
    r->misses[1] = r->whiten[1] * far[0] + r->whiten[2] * far[1];
    for (Word k = 0; k < q->unknowns; k++) {
        double first = dot(r->pair[0], r->middle.change[k]), second = dot(r->pair[1], r->middle.change[k]);
        r->slopes[0][k] = r->whiten[0] * first;
        r->slopes[1][k] = r->whiten[1] * first + r->whiten[2] * second;
    }
}

/* Adds `times` how A'b of a poke changes with the unknowns but for -A'A, with A its slopes and b its misses `left`.
 *
 * With w = D^-1 E (a - c) that is w'E d2c - (D^-1 E dc)' dD w; a turn about an axis changes dc by axis x dc, n by axis x n. */
static void add_bends(const Touches *q, const Row *r, const double left[2], double scale, double bends[UNKNOWNS][UNKNOWNS])
{
    int d = (int)q->unknowns, turns = d < UNKNOWNS ? 1 : 3;
    double w[2] = {r->whiten[0] * left[0] + r->whiten[1] * left[1], r->whiten[2] * left[1]};
    double slopes[2][UNKNOWNS], pulls[UNKNOWNS], pushed[UNKNOWNS], swung[2][UNKNOWNS], out[2][UNKNOWNS];
    Vec pull = plus(times(w[0], r->pair[0]), times(w[1], r->pair[1])), axes[3];
    for (int k = 0; k < turns; k++) {
        Vec axis = turns == 1 ? r->middle.normal : vec(k == 0, k == 1, k == 2);
        axes[k] = times(1.0 / q->rules->turn_to_length_radius, axis);
    }
    for (int j = 0; j < d; j++) {
        Vec change = times(r->share, r->middle.change[j]);
        slopes[0][j] = r->whiten[0] * r->slopes[0][j] + r->whiten[1] * r->slopes[1][j];
        slopes[1][j] = r->whiten[2] * r->slopes[1][j];
        pulls[j] = slopes[0][j] * w[0] + slopes[1][j] * w[1];
        pushed[j] = r->push[0] * dot(r->u, change);
        for (int k = 0; k < 2; k++) {
            swung[k][j] = dot(r->pair[k], change);
            out[k][j] = 0.0;
        }
        if (turns > 1 && j >= d - turns) {
            /* Without a surface the module's normal turns, too. */
            Vec tilted = times(r->beside, cross(axes[j - (d - turns)], r->middle.normal));
            pushed[j] += r->push[1] * dot(r->u, tilted);
            out[0][j] = -dot(r->pair[1], tilted);
            out[1][j] = dot(r->pair[0], tilted);
        }
    }
    double along_swing = r->swing[0] * w[0] + r->swing[1] * w[1], along_skin = r->skin[0] * w[0] + r->skin[1] * w[1];
    for (int j = 0; j < d; j++) {
        double by_swing = r->swing[0] * slopes[0][j] + r->swing[1] * slopes[1][j];
        double by_skin = r->skin[0] * slopes[0][j] + r->skin[1] * slopes[1][j];
        for (int k = 0; k < d; k++) {
            double bend = -2.0 * pulls[j] * pushed[k];
            bend -= (slopes[0][j] * swung[0][k] + slopes[1][j] * swung[1][k]) * along_swing;
            bend -= by_swing * (w[0] * swung[0][k] + w[1] * swung[1][k]);
            bend -= (slopes[0][j] * out[0][k] + slopes[1][j] * out[1][k]) * along_skin;
            bend -= by_skin * (w[0] * out[0][k] + w[1] * out[1][k]);
            /* w'E . (axis x dc) = (w'E x axis) . dc */
            if (j >= d - turns && k >= d - turns) bend += dot(cross(pull, axes[j - (d - turns)]), r->middle.change[k]);
            bends[j][k] += scale * bend;
        }
    }
}

/* ---- how rows hold a module ---- */

/* In the directions of the unknowns that the rows determine: how firmly, 1/m, and how far off, in standard deviations; the
 * directions that they do not determine come last, with 0 and 0. */
typedef struct { int count; double firm[UNKNOWNS], axes[UNKNOWNS][UNKNOWNS], off[UNKNOWNS]; } Hold;

/* Weighted rows by columns, the last of them the misses; the rows in order of their size. */
typedef struct { int count; double *column[WIDE]; } Wide;

static Wide sorted_rows(const Row *rows, const int *some, int count, const double (*misses)[2], const double *weights, int d)
{
    Wide from = {.count = 2 * count > d ? 2 * count : d}, to = from;
    double *keys = ROOM(double, from.count);
    int *order = ROOM(int, from.count);
    for (int j = 0; j <= d; j++) {
        from.column[j] = ROOM(double, from.count);
        to.column[j] = ROOM(double, from.count);
    }
    for (int i = 0; i < from.count; i++) {
        const Row *r = i < 2 * count ? rows + some[i / 2] : 0;
        double root = r ? root_of(weights[i / 2]) : 0.0, sum = 0.0;
        for (int j = 0; j < d; j++) {
            double slope = r ? root * r->slopes[i % 2][j] : 0.0;
            from.column[j][i] = slope;
            sum += slope * slope;
        }
        from.column[d][i] = r ? root * misses[i / 2][i % 2] : 0.0;
        keys[i] = -sum;
    }
    sort_by(keys, from.count, order);
    for (int j = 0; j <= d; j++)
        for (int i = 0; i < from.count; i++) to.column[j][i] = from.column[j][order[i]];
    return to;
}

/* R | c with |A p - b|^2 = |R p - c|^2 + a constant, by Householder's reflections, pivoted: see `factor.h`. R stands in the order
 * of p. */
static void reduce(Wide *rows, int d, double root[UNKNOWNS][WIDE])
{
    int left[UNKNOWNS];
    for (int j = 0; j < d; j++) left[j] = 1;
    for (int k = 0; k < d; k++) {
        double most = -1.0;
        int pivot = 0;
        for (int j = 0; j < d; j++) {
            double squared = left[j] ? product_of(rows->column[j], rows->column[j], k, rows->count) : -1.0;
            if (squared > most) { most = squared; pivot = j; }
        }
        double size = root_of(most), *v = rows->column[pivot];
        for (int j = 0; j <= d; j++) root[k][j] = 0.0;
        if (size == 0.0) continue;
        left[pivot] = 0;
        if (k == d - 1) {
            /* A plain projection: a reflection would add a heavy row's first number to a column that is light. */
            root[k][pivot] = size;
            root[k][d] = product_of(v, rows->column[d], k, rows->count) / size;
            break;
        }
        double alpha = signed_as(size, v[k]), beta = 1.0 / (size * (size + size_of(v[k])));
        v[k] += alpha;
        for (int j = 0; j <= d; j++) {
            double *w = rows->column[j];
            if (j < d && !left[j]) continue;
            double along = beta * product_of(v, w, k, rows->count);
            for (int i = k; i < rows->count; i++) w[i] -= v[i] * along;
            root[k][j] = w[k];
        }
        root[k][pivot] = -alpha;
    }
}

INLINE double inner(const double *a, const double *b, int d)
{
    double sum = 0.0;
    for (int j = 0; j < d; j++) sum += a[j] * b[j];
    return sum;
}

/* Turns rows of R | c into one another until those of R are orthogonal: W R = S V', W c (Jacobi, one-sided; small values keep
 * their digits, Demmel and Veselic 1992). */
static void make_orthogonal(double root[UNKNOWNS][WIDE], int d)
{
    for (int sweep = 0, again = 1; again && sweep < 30; sweep++) {
        again = 0;
        for (int p = 0; p < d; p++)
            for (int q = p + 1; q < d; q++) {
                double pp = inner(root[p], root[p], d), qq = inner(root[q], root[q], d), pq = inner(root[p], root[q], d);
                if (!(size_of(pq) > EPS * root_of(pp) * root_of(qq))) continue;
                double slant = (qq - pp) / (2.0 * pq);
                double tangent = signed_as(1.0, slant) / (size_of(slant) + root_of(1.0 + slant * slant));
                double cosine = 1.0 / root_of(1.0 + tangent * tangent), sine = cosine * tangent;
                for (int j = 0; j <= d; j++) {
                    double one = root[p][j], other = root[q][j];
                    root[p][j] = cosine * one - sine * other;
                    root[q][j] = sine * one + cosine * other;
                }
                again = 1;
            }
    }
}

/* Fills up the directions from `count` on with unit ones across those before. */
static void fill_up(Hold *held, int d)
{
    for (int k = held->count; k < d; k++) {
        double best = -1.0;
        for (int unit = 0; unit < d; unit++) {
            double v[UNKNOWNS] = {0}, size;
            v[unit] = 1.0;
            /* Twice: the first leaves rounding of what it takes off. */
            for (int twice = 0; twice < 2; twice++)
                for (int i = 0; i < k; i++) {
                    double along = inner(held->axes[i], v, d);
                    for (int j = 0; j < d; j++) v[j] -= along * held->axes[i][j];
                }
            size = root_of(inner(v, v, d));
            if (!(size > best)) continue;
            best = size;
            for (int j = 0; j < d; j++) held->axes[k][j] = v[j] / size;
        }
        held->firm[k] = held->off[k] = 0.0;
    }
}

/* How some pokes hold a module, by number in `rows`, with their misses and weights in the order of `some`. */
static Hold hold_of(
    const Touches *q, const Row *rows, const int *some, int count, const double (*misses)[2], const double *weights)
{
    unsigned char *mark = top;
    int d = (int)q->unknowns;
    double root[UNKNOWNS][WIDE] = {0}, firm[UNKNOWNS], most = 0.0;
    Wide wide = sorted_rows(rows, some, count, misses, weights, d);
    Hold held = {.count = 0};
    reduce(&wide, d, root);
    make_orthogonal(root, d);
    for (int k = 0; k < d; k++) {
        firm[k] = root_of(inner(root[k], root[k], d));
        most = larger(most, firm[k]);
    }
    for (int k = 0; k < d; k++) {
        if (!(firm[k] > q->rules->min_singular_value_ratio * most)) continue;
        held.firm[held.count] = firm[k];
        held.off[held.count] = root[k][d];
        for (int j = 0; j < d; j++) held.axes[held.count][j] = root[k][j] / firm[k];
        held.count++;
    }
    fill_up(&held, d);
    top = mark;
    return held;
}

/* The move by `off`, standard deviations along the directions; none too long: one hardly known does not hold up the others. */
static void move_of(const Touches *q, const Hold *held, const double *off, double most, double move[UNKNOWNS])
{
    for (Word j = 0; j < q->unknowns; j++) {
        move[j] = 0.0;
        for (int k = 0; k < held->count; k++)
            move[j] += held->axes[k][j] * smaller(larger(off[k] / held->firm[k], -most), most);
    }
}

/* ---- trust ---- */

static double median_of(const double *values, int count)
{
    unsigned char *mark = top;
    int *order = ROOM(int, count);
    sort_by(values, count, order);
    double high = values[order[count / 2]], low = values[order[(count - 1) / 2]];
    top = mark;
    return (low + high) / 2.0;
}

static double sum_of(const double *values, int count)
{
    Sum total = {0, 0};
    for (int i = 0; i < count; i++) add(&total, values[i]);
    return total_of(total);
}

/* Fills in the trust of some of a module's pokes, by steps from its pose in which far pokes pull little. */
static void trust_some(const Touches *q, const Row *rows, const int *some, int count, double *trust)
{
    for (int i = 0; i < count; i++) trust[some[i]] = 1.0;
    if (count < MIN_POKES_FOR_TRUST) return;
    unsigned char *mark = top;
    double *pitches = ROOM(double, count), *squares = ROOM(double, count), *weights = ROOM(double, count);
    double (*left)[2] = (double (*)[2])room(sizeof(double[2]) * (unsigned long)count), move[UNKNOWNS];
    double raised = 1.0 + SMALL_SAMPLE_SPREAD_CORRECTION / (2 * count - 3);
    for (int i = 0; i < count; i++) {
        pitches[i] = rows[some[i]].pitch;
        for (int k = 0; k < 2; k++) left[i][k] = rows[some[i]].misses[k];
    }
    double usual = larger(1.0, raised * median_of(pitches, count) / CHI2_1DOF_MEDIAN);
    for (int i = 0; i < count; i++) pitches[i] /= usual;
    for (int step = 0; step < q->rules->robust_search_steps; step++) {
        for (int i = 0; i < count; i++)
            weights[i] = 1.0 / larger(square(left[i][0]) + square(left[i][1]) + pitches[i], square(FULL_WEIGHT_MAX_MISS_SDS));
        Hold held = hold_of(q, rows, some, count, (const double (*)[2])left, weights);
        move_of(q, &held, held.off, q->rules->max_step, move);
        for (int i = 0; i < count; i++)
            for (int k = 0; k < 2; k++) left[i][k] -= inner(rows[some[i]].slopes[k], move, (int)q->unknowns);
    }
    for (int i = 0; i < count; i++) squares[i] = square(left[i][0]) + square(left[i][1]);
    usual = larger(1.0, raised * median_of(squares, count) / CHI2_2DOF_MEDIAN);
    for (int i = 0; i < count; i++) weights[i] = trust_at(squares[i] / usual + pitches[i]);
    if (!(sum_of(weights, count) < MIN_SUM_OF_POKE_TRUSTS)) for (int i = 0; i < count; i++) trust[some[i]] = weights[i];
    top = mark;
}

/* Fills in the trust of a module's pokes, each judged among those of its arm pose, or among all that are left over. */
static void trust_module(const Boards *q, int module, const Row *rows, double *trust)
{
    unsigned char *mark = top;
    int begin = q->spans[module], count = q->spans[module + 1] - begin, rest = 0;
    double *poses = ROOM(double, count);
    int *order = ROOM(int, count), *others = ROOM(int, count), *alone = ROOM(int, count);
    for (int i = 0; i < count; i++) {
        poses[i] = q->touches.poses[begin + i];
        alone[i] = 1;
    }
    sort_by(poses, count, order);
    for (int first = 0, end; first < count; first = end) {
        for (end = first; end < count && q->touches.poses[begin + order[end]] == q->touches.poses[begin + order[first]];) end++;
        if (end - first < q->touches.rules->min_pokes_per_arm_pose) continue;
        trust_some(&q->touches, rows, order + first, end - first, trust);
        for (int i = first; i < end; i++) alone[order[i]] = 0;
    }
    for (int i = 0; i < count; i++) if (alone[i]) others[rest++] = i;
    trust_some(&q->touches, rows, others, rest, trust);
    if (sum_of(trust, count) < MIN_SUM_OF_POKE_TRUSTS) for (int i = 0; i < count; i++) trust[i] = 1.0;
    top = mark;
}

/* ---- the search ---- */

/* Solves C x = b in place, C (n, n); 0 where C + C' has a value of 2 `least` or less. */
static int solved(double c[UNKNOWNS][UNKNOWNS], int n, double least, double *b)
{
    double low[UNKNOWNS][UNKNOWNS];
    for (int j = 0; j < n; j++)
        for (int i = j; i < n; i++) {
            double sum = 0.5 * (c[i][j] + c[j][i]) - (i == j ? least : 0.0);
            for (int k = 0; k < j; k++) sum -= low[i][k] * low[j][k];
            if (i == j && !(sum > 0.0)) return 0;
            low[i][j] = i == j ? root_of(sum) : sum / low[j][j];
        }
    /* What is positive needs no pivots. */
    for (int k = 0; k < n; k++)
        for (int i = k + 1; i < n; i++) {
            double share = c[i][k] / c[k][k];
            for (int j = k; j < n; j++) c[i][j] -= share * c[k][j];
            b[i] -= share * b[k];
        }
    for (int i = n - 1; i >= 0; i--) {
        for (int j = i + 1; j < n; j++) b[i] -= c[i][j] * b[j];
        b[i] /= c[i][i];
    }
    return 1;
}

/* Pokes in which sums do not depend on how they are numbered. */
static int *by_size(const Row *rows, int count, int d)
{
    int *order = ROOM(int, count);
    unsigned char *mark = top;
    double *keys = ROOM(double, count);
    for (int i = 0; i < count; i++) keys[i] = -(inner(rows[i].slopes[0], rows[i].slopes[0], d) + inner(rows[i].slopes[1], rows[i].slopes[1], d));
    sort_by(keys, count, order);
    top = mark;
    return order;
}

/* The step of a module where its rows hold it so; how these change is used where that leaves it held. */
static void newton(
    const Touches *q, const Row *rows, const int *order, int count, const double *trust, const Hold *held, double step[UNKNOWNS])
{
    int d = (int)q->unknowns;
    double far[UNKNOWNS], bends[UNKNOWNS][UNKNOWNS] = {{0}}, curvature[UNKNOWNS][UNKNOWNS], off[UNKNOWNS], bent[UNKNOWNS];
    move_of(q, held, held->off, INFINITE, far);
    for (int i = 0; i < count; i++) {
        const Row *r = rows + order[i];
        /* What would be left of the misses if the rows were linear, however far it had to go. */
        double left[2] = {r->misses[0] - inner(r->slopes[0], far, d), r->misses[1] - inner(r->slopes[1], far, d)};
        add_bends(q, r, left, trust[order[i]], bends);
    }
    for (int i = 0; i < held->count; i++) {
        off[i] = held->off[i];
        for (int j = 0; j < d; j++) {
            bent[j] = 0.0;
            for (int k = 0; k < d; k++) bent[j] += held->axes[i][k] * bends[k][j];
        }
        for (int k = 0; k < held->count; k++)
            curvature[i][k] = (i == k) - inner(bent, held->axes[k], d) / (held->firm[i] * held->firm[k]);
    }
    move_of(q, held, solved(curvature, held->count, q->rules->min_curvature, off) ? off : held->off, q->rules->max_step, step);
}

/* Adds to the covariance what errors of the arm's poses do, each one for all pokes in it: a pose turned by w about the sensor
 * and shifted by t moves the axis by w x lever + t. */
static void add_arm_poses(const Boards *q, int module, const Row *rows, const double *trust, const double *inverse, double *covariance)
{
    unsigned char *mark = top;
    int d = (int)q->touches.unknowns, begin = q->spans[module], count = q->spans[module + 1] - begin;
    double *poses = ROOM(double, count);
    int *order = ROOM(int, count);
    for (int i = 0; i < count; i++) poses[i] = q->touches.poses[begin + i];
    sort_by(poses, count, order);
    for (int first = 0; first < count;) {
        double part[UNKNOWNS][6] = {{0}};
        int pose = q->touches.poses[begin + order[first]];
        for (; first < count && q->touches.poses[begin + order[first]] == pose; first++) {
            const Row *r = rows + order[first];
            for (int k = 0; k < 6; k++) {
                Vec axis = vec(k % 3 == 0, k % 3 == 1, k % 3 == 2);
                Vec way = k < 3 ? times(q->touches.noise->pose_turn, cross(axis, r->lever)) : times(q->touches.noise->pose_shift, axis);
                double one = dot(r->pair[0], way), other = dot(r->pair[1], way);
                double moves[2] = {r->whiten[0] * one, r->whiten[1] * one + r->whiten[2] * other};
                for (int j = 0; j < d; j++)
                    part[j][k] += trust[order[first]] * (r->slopes[0][j] * moves[0] + r->slopes[1][j] * moves[1]);
            }
        }
        double gained[UNKNOWNS][6];
        for (int i = 0; i < d; i++)
            for (int k = 0; k < 6; k++) {
                gained[i][k] = 0.0;
                for (int j = 0; j < d; j++) gained[i][k] += inverse[d * i + j] * part[j][k];
            }
        for (int i = 0; i < d; i++)
            for (int j = 0; j < d; j++) covariance[d * i + j] += inner(gained[i], gained[j], 6);
    }
    top = mark;
}

/* Writes how well a module's unknowns are known, which are not, and at what distance the axes pass the middles. */
static void say_held(const Boards *q, int module, const Row *rows, const double *trust, const Hold *held)
{
    int d = (int)q->touches.unknowns, count = q->spans[module + 1] - q->spans[module];
    double *covariance = q->covariances + d * d * module, *blind = q->blind + d * d * module, inverse[UNKNOWNS * UNKNOWNS];
    for (int i = 0; i < d; i++)
        for (int j = 0; j < d; j++) {
            double sum = 0.0;
            for (int k = 0; k < held->count; k++) sum += held->axes[k][i] / held->firm[k] * (held->axes[k][j] / held->firm[k]);
            covariance[d * i + j] = inverse[d * i + j] = sum;
            blind[d * i + j] = i < held->count ? 0.0 : held->axes[i][j];
        }
    if (q->touches.noise->pose_turn > 0 || q->touches.noise->pose_shift > 0) add_arm_poses(q, module, rows, trust, inverse, covariance);
    Sum squares = {0, 0}, weights = {0, 0};
    for (int i = 0; i < count; i++) {
        add(&squares, trust[i] * square(rows[i].distance));
        add(&weights, trust[i]);
    }
    q->misses[module] = root_of(total_of(squares) / larger(total_of(weights), 1e-300));
}

static Hold module_hold(const Boards *q, const Row *rows, const int *order, int count, const double *trust)
{
    unsigned char *mark = top;
    double *weights = ROOM(double, count), (*misses)[2] = (double (*)[2])room(sizeof(double[2]) * (unsigned long)count);
    for (int i = 0; i < count; i++) {
        weights[i] = trust[order[i]];
        for (int k = 0; k < 2; k++) misses[i][k] = rows[order[i]].misses[k];
    }
    Hold held = hold_of(&q->touches, rows, order, count, (const double (*)[2])misses, weights);
    top = mark;
    return held;
}

/* Moves pads after a step of their module that is too short for more than the gradient. */
static void shift(const Boards *q, int module, const double step[UNKNOWNS])
{
    int d = (int)q->touches.unknowns;
    for (int i = 3 * q->boards[module]; i < 3 * q->boards[module + 1]; i++) q->touches.pads[i] += inner(q->touches.changes + d * i, step, d);
}

static void rows_of_module(const Boards *q, int module, Row *rows)
{
    for (int i = q->spans[module]; i < q->spans[module + 1]; i++) row_of(&q->touches, i, rows + (i - q->spans[module]));
}

static void put_row(const RowTable *to, const Touches *q, int i, const Row *r)
{
    int d = (int)q->unknowns;
    double bends[UNKNOWNS][UNKNOWNS] = {{0}};
    add_bends(q, r, r->misses, 1.0, bends);
    for (int k = 0; k < 2; k++) {
        for (int j = 0; j < d; j++) to->row_slopes[(2 * i + k) * d + j] = r->slopes[k][j];
        to->row_misses[2 * i + k] = r->misses[k];
    }
    to->row_whiten[4 * i] = r->whiten[0];
    to->row_whiten[4 * i + 1] = 0.0;
    to->row_whiten[4 * i + 2] = r->whiten[1];
    to->row_whiten[4 * i + 3] = r->whiten[2];
    put(to->row_normals + 3 * i, r->middle.normal);
    for (int j = 0; j < d; j++)
        for (int k = 0; k < d; k++) to->row_bends[(i * d + j) * d + k] = bends[j][k];
}

/* Moves a module to where its rows hold it best. */
static void place(const Boards *q, int module)
{
    const Rules *rules = q->touches.rules;
    int d = (int)q->touches.unknowns, count = q->spans[module + 1] - q->spans[module], settled = 0;
    Pose at = {vec_at(q->points + 3 * module), vec_at(q->x + 3 * module), vec_at(q->normals + 3 * module), q->triangles[module]};
    Row *rows = ROOM(Row, count);
    double *trust = q->trust + q->spans[module], step[UNKNOWNS], before[UNKNOWNS] = {0}, last = rules->max_step;
    lay(q, module, &at);
    rows_of_module(q, module, rows);
    if (q->doubting) trust_module(q, module, rows, trust);
    int *order = by_size(rows, count, d);
    Hold held = module_hold(q, rows, order, count, trust);
    for (int steps = 0; !settled && steps < rules->max_steps; steps++) {
        newton(&q->touches, rows, order, count, trust, &held, step);
        int back = inner(step, before, d) < -rules->min_reversal_share * inner(before, before, d);
        double size = 0.0;
        for (int j = 0; j < d; j++) {
            step[j] *= back ? 0.5 : 1.0;
            before[j] = step[j];
            size = larger(size, size_of(step[j]));
        }
        settled = size <= rules->rounding_max_step && (size * size <= rules->converged_step * last || 2.0 * size >= last);
        at = moved(q, &at, step);
        last = size;
        if (settled) {
            shift(q, module, step);
        } else {
            lay(q, module, &at);
            rows_of_module(q, module, rows);
            order = by_size(rows, count, d);
            held = module_hold(q, rows, order, count, trust);
        }
    }
    put(q->points + 3 * module, at.point);
    put(q->x + 3 * module, at.x);
    put(q->normals + 3 * module, at.normal);
    q->triangles[module] = at.triangle;
    q->moving[module] = settled ? 0.0 : last;
    say_held(q, module, rows, trust, &held);
    /* At the pads as the last step left them. */
    rows_of_module(q, module, rows);
    for (int i = 0; i < count; i++) put_row(&q->rows, &q->touches, q->spans[module] + i, rows + i);
}

#endif
