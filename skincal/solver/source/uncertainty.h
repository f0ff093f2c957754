/* How well the contacts determine a position, from the rig's noise and never from the residuals.
 *
 * Residuals of nearly parallel axes agree beautifully and are wrong, so the noise model speaks. In the sensor frame a
 * contact's residual is f x p + m; noise df and dm and a contact at p + c instead of p change it by dm - p x df + f x c.
 * With isotropic df and dm and c in the plane of the skin, unit normal n, its covariance is
 *
 *     C = sigma_m^2 I + sigma_f^2 S(q) S(q)' + |f|^2 s^2 S(u) (I - n n') S(u)',
 *
 * where the lever q = p - o runs from the sensor's origin o, about which the moment was measured. Eq. (6) turns the
 * residual into the link frame and no more, so C is turned with it: q, u and n are just written in the link frame.
 *
 * Offsets. A contact in which the taxel answers less than its neighbour is a poke on the neighbour. If answers fall like a
 * bell of width `reach` about the tip, an answer of share k is off by s^2 = contact^2 + reach^2 ln(1/k) in each direction.
 * Neighbours' offsets do not average out: pokes on one neighbour share theirs. Where the taxel has pokes of its own, the
 * neighbours lie round it and nearly cancel; the more of its evidence is theirs, the fewer they are and the more
 * one-sided. So of the reach's part a share lambda^2 is taken as one offset common to all, with
 * lambda = min(1, mean of sqrt(ln(1/k)) / NEIGHBOURS_SHARE_ONE_OFFSET_FROM).
 *
 * Bend. Beside a taxel on a convex part the normal leans outward by c/radius, and the pokes lean with it: the axes converge
 * below the skin. So offsets and directions are correlated, E[c] = -s^2/(2 radius) u_t/v, with u_t the direction's part
 * along the skin and v its weighted mean square in each direction; half, since a limb bends one way. The free method's
 * depth is off by what these offsets make of it, beta; it is taken as a standard deviation, not taken off, since it says
 * nothing of hollows.
 *
 * The two rows e_i.(p - a) of a contact are T (f x p + m)/|f| with T = [e_2; -e_1], since e_i.(u x v) = (e_i x u).v, so
 * their covariance is D = T C T'/|f|^2. The estimate is linear in the rows, p = G b with G = (A'A)^-1 A', so its covariance
 * is Sigma = G (K D K) G' + what is common: the estimator's own weights k, the rig's own noise. Confined to directions B
 * (3 x d), as on a triangle, A becomes A B and Sigma becomes B (...) B'.
 *
 * It leaves out what all contacts share: wrong frames, a wrong mesh, errors of the F/T matrix; and errors of the arm's
 * poses unless the noise says how large they are.
 */
#ifndef UNCERTAINTY_H
#define UNCERTAINTY_H

#include "factor.h"

/* The d directions in which a position is free, 3 or 2, and how the rows hold it there. */
typedef struct {
    int d;
    Vec basis[3];         /* B, its orthonormal columns */
    double inverse[3][3]; /* R^-1, where A B = Q R, so that G = B R^-1 Q' without a squared condition */
    Vec flattest;         /* unit, along which the rows change least, where they do not determine all */
    int determined;
} Freedom;

/* The covariance of a position and its worst direction. */
typedef struct {
    double covariance[9]; /* without meaning where sd is infinite */
    Vec weakest;          /* unit; its largest component is positive: a line has no sign */
    double sd;            /* metres, along `weakest`; infinite where a direction is not determined at all */
} Uncertainty;

/* The freedom of a position that may lie anywhere. */
static Freedom in_space(const Factor *f)
{
    Freedom free = {.d = 3, .flattest = f->blind, .determined = f->rank == 3};
    double (*inverse)[3] = free.inverse;
    for (int j = 0; j < 3; j++) {
        free.basis[j] = vec(0, 0, 0);
        free.basis[j].at[f->order[j]] = 1.0;
        for (int k = 0; k < 3; k++) inverse[j][k] = 0.0;
    }
    for (int j = 0; j < 3; j++) inverse[j][j] = 1.0 / root_at(f, j, j);
    inverse[0][1] = -root_at(f, 0, 1) * inverse[0][0] * inverse[1][1];
    inverse[1][2] = -root_at(f, 1, 2) * inverse[1][1] * inverse[2][2];
    inverse[0][2] = -(root_at(f, 0, 1) * inverse[1][2] + root_at(f, 0, 2) * inverse[2][2]) * inverse[0][0];
    return free;
}

/* The freedom of a position that lies in a plane with this unit normal. */
static Freedom in_plane(const Factor *f, Vec normal)
{
    Freedom free = {.d = 2};
    Vec one, two;
    across(normal, &one, &two);
    Vec first = apply(&f->root, one), second = apply(&f->root, two);
    /* The longer column first, as in `factor.h`. */
    int swap = dot(first, first) < dot(second, second);
    Vec head = swap ? second : first, tail = swap ? first : second;
    free.basis[0] = swap ? two : one;
    free.basis[1] = swap ? one : two;
    double far = length(head), along = dot(head, tail) / far;
    double near = length(minus(tail, times(along / far, head)));
    free.inverse[0][0] = 1.0 / far;
    free.inverse[1][1] = 1.0 / near;
    free.inverse[0][1] = -along * free.inverse[0][0] * free.inverse[1][1];
    free.inverse[1][0] = 0.0;
    Vec flat = minus(free.basis[1], times(along / far, free.basis[0]));
    free.flattest = times(1.0 / length(flat), flat);
    free.determined = near > NO_RANK * far;
    return free;
}

/* ---- the sandwich ---- */

typedef struct {
    const Contacts *c;
    const Noise *noise;
    const Freedom *free;
    Vec p;                     /* metres, where the noise is evaluated */
    Vec normal;                /* unit, of the skin, of either sign; zero where pushes cancel */
    double *first[3], *second[3]; /* how far each contact's two rows move the d coordinates of Q */
} Carried;

/* Q = A B R^-1, its rows multiplied by the estimator's weights once more. */
static void carry_rows(Carried *k)
{
    const Freedom *free = k->free;
    for (int j = 0; j < free->d; j++) {
        Vec held = vec(0, 0, 0);
        for (int m = 0; m < free->d; m++) held = plus(held, times(free->inverse[m][j], free->basis[m]));
        k->first[j] = ROOM(double, k->c->count);
        k->second[j] = ROOM(double, k->c->count);
        for (int i = 0; i < k->c->count; i++) {
            double share = square(k->c->scale[i]);
            k->first[j][i] = share * dot(column(k->c->first, i), held);
            k->second[j][i] = share * dot(column(k->c->second, i), held);
        }
    }
}

/* lambda: which share of the neighbours' offsets is common to all. */
static double common_share(const Contacts *c)
{
    double sum = 0, shares = 0;
    for (int i = 0; i < c->count; i++) {
        double share = square(c->scale[i]);
        sum += share * c->weakness[i];
        shares += share;
    }
    return smaller(sum / shares / NEIGHBOURS_SHARE_ONE_OFFSET_FROM, 1.0);
}

/* Adds what sensor and offsets do. */
static void add_contacts(const Carried *k, double middle[3][3])
{
    int d = k->free->d;
    double lambda = common_share(k->c);
    Vec moved[3] = {{{0, 0, 0}}, {{0, 0, 0}}, {{0, 0, 0}}};
    for (int i = 0; i < k->c->count; i++) {
        Vec e1 = column(k->c->first, i), e2 = column(k->c->second, i);
        double common = k->noise->reach * k->c->weakness[i] * lambda, own = k->c->square[i] - common * common;
        double out1 = dot(e1, k->normal), out2 = dot(e2, k->normal);
        RowNoise n = sensor_noise(k->c, i, k->p, k->noise);
        double even = n.even + own;
        double d11 = even - square(n.less[0]) - own * out1 * out1, d22 = even - square(n.less[1]) - own * out2 * out2;
        double d12 = -n.less[0] * n.less[1] - own * out1 * out2;
        for (int j = 0; j < d; j++) {
            double q1 = k->first[j][i], q2 = k->second[j][i];
            double x1 = d11 * q1 + d12 * q2, x2 = d12 * q1 + d22 * q2;
            for (int m = 0; m <= j; m++) middle[j][m] += x1 * k->first[m][i] + x2 * k->second[m][i];
            moved[j] = plus(moved[j], times(common, plus(times(q1, e1), times(q2, e2))));
        }
    }
    for (int j = 0; j < d; j++) moved[j] = minus(moved[j], times(dot(moved[j], k->normal), k->normal));
    for (int j = 0; j < d; j++)
        for (int m = 0; m <= j; m++) middle[j][m] += dot(moved[j], moved[m]);
}

/* Adds what the skin's bend does: beta beta', since offsets go with the push's lean. */
static void add_bend(const Carried *k, double middle[3][3])
{
    double shares = 0, lean = 0, beta[3] = {0, 0, 0};
    for (int i = 0; i < k->c->count; i++) {
        double out1 = dot(column(k->c->first, i), k->normal), out2 = dot(column(k->c->second, i), k->normal);
        double share = square(k->c->scale[i]);
        shares += share;
        /* The lean's squared sine; no lean is known better than the force's direction. */
        lean += share * ((out1 * out1 + out2 * out2) / 2.0 + square(k->noise->force / k->c->force[i]));
        /* e_i.u_t = e_i.(u - (n.u) n) = -(n.u) (e_i.n). */
        double far = k->c->square[i] * dot(column(k->c->u, i), k->normal);
        for (int j = 0; j < 3; j++) beta[j] += far * (out1 * k->first[j][i] + out2 * k->second[j][i]);
    }
    double size = shares / lean / (2.0 * k->noise->radius);
    for (int j = 0; j < 3; j++)
        for (int m = 0; m <= j; m++) middle[j][m] += size * beta[j] * (size * beta[m]);
}

/* Fills `order` with the contacts pose by pose, the poses in the order in which the evidence has them: their numbers tell
 * which came first, and may not count. */
static void order_by_pose(const int *pose, int count, int *order)
{
    double *keys = ROOM(double, count);
    for (int i = 0; i < count; i++) keys[i] = pose[i];
    sort_by(keys, count, order);
    for (int at = 0, head = 0; at < count; at++) {
        if (at == 0 || pose[order[at]] != pose[order[at - 1]]) head = order[at];
        keys[order[at]] = head;
    }
    sort_by(keys, count, order);
}

/* Adds what the arm's poses do: each moves all contacts in it by dtheta x q + dt. */
static void add_poses(const Carried *k, double middle[3][3])
{
    const Contacts *c = k->c;
    int d = k->free->d, *order = ROOM(int, c->count);
    order_by_pose(c->pose, c->count, order);
    for (int begin = 0, end; begin < c->count; begin = end) {
        Vec moved[3] = {{{0, 0, 0}}, {{0, 0, 0}}, {{0, 0, 0}}};
        for (end = begin; end < c->count && c->pose[order[end]] == c->pose[order[begin]]; end++) {
            int i = order[end];
            for (int j = 0; j < d; j++)
                moved[j] = plus(moved[j], plus(times(k->first[j][i], column(c->first, i)),
                                               times(k->second[j][i], column(c->second, i))));
        }
        Vec lever = times(k->noise->pose_turn, minus(k->p, column(c->sensor, order[begin])));
        for (int j = 0; j < d; j++)
            for (int m = 0; m <= j; m++)
                middle[j][m] += dot(cross(moved[j], lever), cross(moved[m], lever))
                              + square(k->noise->pose_shift) * dot(moved[j], moved[m]);
    }
}

/* ---- the largest eigenvalue ---- */

/* Turns rows and columns p and q of a symmetric matrix so that their common number is zero (Jacobi 1846). */
static void turn(double a[3][3], double v[3][3], int d, int p, int q)
{
    if (a[p][q] == 0.0) return;
    double theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    double t = signed_as(1.0, theta) / (size_of(theta) + root_of(theta * theta + 1.0));
    double c = 1.0 / root_of(t * t + 1.0), s = t * c;
    for (int k = 0; k < d; k++) {
        double x = a[k][p], y = a[k][q];
        a[k][p] = c * x - s * y;
        a[k][q] = s * x + c * y;
    }
    for (int k = 0; k < d; k++) {
        double x = a[p][k], y = a[q][k];
        a[p][k] = c * x - s * y;
        a[q][k] = s * x + c * y;
    }
    for (int k = 0; k < d; k++) {
        double x = v[k][p], y = v[k][q];
        v[k][p] = c * x - s * y;
        v[k][q] = s * x + c * y;
    }
}

/* The largest eigenvalue of a symmetric d x d matrix, and its unit eigenvector. */
static double largest_of(double a[3][3], int d, double vector[3])
{
    double v[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    /* Each sweep squares what is left beside the diagonal: eight are more than enough. */
    for (int sweep = 0; sweep < 8; sweep++)
        for (int p = 0; p < d; p++)
            for (int q = p + 1; q < d; q++) turn(a, v, d, p, q);
    int best = 0;
    for (int j = 1; j < d; j++) if (a[j][j] > a[best][best]) best = j;
    for (int j = 0; j < 3; j++) vector[j] = j < d ? v[j][best] : 0.0;
    return a[best][best];
}

static Vec unsigned_line(Vec v)
{
    double most = v.x;
    if (size_of(v.y) > size_of(most)) most = v.y;
    if (size_of(v.z) > size_of(most)) most = v.z;
    double size = signed_as(length(v), most);
    return size != 0 ? vec(v.x / size, v.y / size, v.z / size) : v;
}

/* Fills the lower half into the upper one, and returns R^-1 middle R^-1'. */
static void between_inverses(double middle[3][3], const Freedom *free, double small[3][3])
{
    int d = free->d;
    double half[3][3];
    for (int j = 0; j < d; j++)
        for (int m = j + 1; m < d; m++) middle[j][m] = middle[m][j];
    for (int j = 0; j < d; j++)
        for (int m = 0; m < d; m++) {
            half[j][m] = 0;
            for (int n = j; n < d; n++) half[j][m] += free->inverse[j][n] * middle[n][m];
        }
    for (int j = 0; j < d; j++)
        for (int m = 0; m <= j; m++) {
            small[j][m] = 0;
            for (int n = m; n < d; n++) small[j][m] += half[j][n] * free->inverse[m][n];
            small[m][j] = small[j][m];
        }
}

/* Carries the rig's noise through the weighted least squares to a position at p. */
static Uncertainty propagate(const Contacts *c, const Freedom *free, Vec p, const Noise *noise)
{
    unsigned char *mark = top;
    Vec normal = free->d == 3 ? along_push(c) : cross(free->basis[0], free->basis[1]);
    Carried k = {.c = c, .noise = noise, .free = free, .p = p, .normal = normal};
    double middle[3][3] = {{0}}, small[3][3] = {{0}}, direction[3];
    Uncertainty found;
    carry_rows(&k);
    add_contacts(&k, middle);
    if (free->d == 3) add_bend(&k, middle);
    if (noise->pose_turn > 0 || noise->pose_shift > 0) add_poses(&k, middle);
    top = mark;
    between_inverses(middle, free, small);
    int known = free->determined;
    for (int r = 0; r < 3; r++)
        for (int s = 0; s <= r; s++) {
            double sum = 0;
            for (int j = 0; j < free->d; j++)
                for (int m = 0; m < free->d; m++)
                    sum += free->basis[j].at[r] * small[j][m] * free->basis[m].at[s];
            found.covariance[3 * r + s] = found.covariance[3 * s + r] = sum;
            known = known && finite(sum);
        }
    found.weakest = free->flattest;
    found.sd = INFINITE;
    if (known) {
        found.sd = root_of(largest_of(small, free->d, direction));
        found.weakest = vec(0, 0, 0);
        for (int j = 0; j < free->d; j++) found.weakest = plus(found.weakest, times(direction[j], free->basis[j]));
    }
    found.weakest = unsigned_line(found.weakest);
    return found;
}

#endif
