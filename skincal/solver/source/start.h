/* Where the search for a module's pose begins: the pose that fits the estimates of its taxels by another method.
 *
 * The mathematics stands above `skincal/modules/pose_fit.py`.
 */
#ifndef START_H
#define START_H

#include "modules.h"
#include "search.h"

/* Points of a plane as complex numbers: to turn is to multiply. */
typedef struct { double re, im; } Complex;

INLINE Complex difference(Complex a, Complex b) { return (Complex){a.re - b.re, a.im - b.im}; }
INLINE Complex product(Complex a, Complex b) { return (Complex){a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re}; }
INLINE double square_of_size(Complex a) { return a.re * a.re + a.im * a.im; }

static Complex weighted_mean(const Complex *values, const double *weights, int count)
{
    Complex sum = {0, 0};
    double whole = 0;
    for (int i = 0; i < count; i++) {
        sum.re += weights[i] * values[i].re;
        sum.im += weights[i] * values[i].im;
        whole += weights[i];
    }
    return (Complex){sum.re / whole, sum.im / whole};
}

/* Moves a pose onto the surface, where it faces outward: the inner face of a thin wall may be nearer. Returns whether it does. */
static int move_to_ground(const Starts *q, Vec *point, Vec *x, Vec *normal, int *triangle)
{
    const Surface *s = q->ground->surface;
    const Matrix unit = {{vec(1, 0, 0), vec(0, 1, 0), vec(0, 0, 1)}};
    Vec push = times(-1.0, *normal);
    Metric m = metric_of(s, &unit, *point, 0);
    Best best = nearest_to(s, &m, -1);
    if (dot(vec_at(s->normals + 3 * best.triangle), push) >= 0.0) {
        m = metric_of(s, &unit, *point, &push);
        Best faced = nearest_to(s, &m, -1);
        if (faced.triangle >= 0) best = faced;
    }
    Vec facing = vec_at(s->normals + 3 * best.triangle), along = minus(*x, times(dot(*x, facing), facing));
    double size = length(along);
    if (dot(facing, *normal) <= 0.0 || size < q->rules->min_direction) return 0;
    *point = best.point;
    *x = vec(along.x / size, along.y / size, along.z / size);
    *normal = facing;
    *triangle = best.triangle;
    return 1;
}

/* Finds the pose of a module that fits its estimates; returns whether there is one. */
static int start_module(const Starts *q, int module)
{
    int begin = q->spans[module], count = q->spans[module + 1] - begin, planned = q->planned[module], triangle = -1;
    const double *given = q->weights + begin, *places = q->places + 3 * begin;
    double *weights = ROOM(double, count), whole = 0, height = 0;
    Complex *flat = ROOM(Complex, count), *own = ROOM(Complex, count), turn = {1, 0}, shift = {0, 0};
    if (!count) return 0;
    Vec normal = vec(0, 0, 0), across_it, other, x;
    for (int i = 0; i < count; i++) normal = plus(normal, times(given[i], vec_at(q->outward + 3 * (begin + i))));
    /* Without a surface the mean push gives the normal worse than the plan does. */
    if (planned && (length(normal) == 0.0 || !q->ground)) normal = vec_at(q->planned_normals + 3 * module);
    double size = length(normal);
    if (size == 0.0) return 0;
    normal = vec(normal.x / size, normal.y / size, normal.z / size);
    across(normal, &across_it, &other);
    x = across_it;
    if (planned) {
        Vec plan = vec_at(q->planned_x + 3 * module);
        x = minus(plan, times(dot(plan, normal), normal));
    }
    size = length(x);
    x = size > q->rules->min_direction ? vec(x.x / size, x.y / size, x.z / size) : across_it;
    Vec y = cross(normal, x);
    for (int i = 0; i < count; i++) {
        flat[i] = (Complex){dot(vec_at(places + 3 * i), x), dot(vec_at(places + 3 * i), y)};
        own[i] = (Complex){q->flat[2 * (begin + i)], q->flat[2 * (begin + i) + 1]};
        weights[i] = given[i];
    }
    for (int step = 0; step < q->rules->reweighting_steps; step++) {
        Complex middle = weighted_mean(own, weights, count), centre = weighted_mean(flat, weights, count), sum = {0, 0};
        double spread = 0;
        for (int i = 0; i < count; i++) {
            Complex arm = difference(own[i], middle), turned = product((Complex){arm.re, -arm.im}, difference(flat[i], centre));
            sum.re += weights[i] * turned.re;
            sum.im += weights[i] * turned.im;
            spread += weights[i] * square_of_size(arm);
        }
        size = root_of(square_of_size(sum));
        int known = spread * square(q->rules->turn_max_sd) > 1.0 && size > 0;
        if (!known && !planned) return 0;
        turn = known ? (Complex){sum.re / size, sum.im / size} : (Complex){1, 0};
        shift = difference(centre, product(turn, middle));
        for (int i = 0; i < count; i++) {
            Complex off = difference(difference(flat[i], product(turn, own[i])), shift);
            weights[i] = given[i] / (1.0 + square_of_size(off) / square(q->rules->residual_scale));
        }
    }
    for (int i = 0; i < count; i++) {
        height += weights[i] * dot(vec_at(places + 3 * i), normal);
        whole += weights[i];
    }
    Vec point = plus(plus(times(shift.re, x), times(shift.im, y)), times(height / whole, normal));
    x = plus(times(turn.re, x), times(turn.im, y));
    if (q->ground && !move_to_ground(q, &point, &x, &normal, &triangle)) return 0;
    put(q->points + 3 * module, point);
    put(q->x + 3 * module, x);
    put(q->normals + 3 * module, normal);
    q->triangles[module] = triangle;
    return 1;
}

#endif
