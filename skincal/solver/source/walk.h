/* Straight ways over a mesh: each triangle in a plane of its own, and how to turn into its neighbours' planes.
 *
 * On a mesh a straight geodesic is straight within each triangle, and at an edge it goes on as it would if both triangles were
 * unfolded into one plane (Polthier and Schmies, "Straightest geodesics on polyhedral surfaces", 1998). So a walk is worked out
 * in the two coordinates of the triangle that it is in; at an edge they are turned into those of the next one. Past the rim it
 * goes on straight in the last triangle's plane.
 */
#ifndef WALK_H
#define WALK_H

#include "search.h"

/* A walk through less than this of a triangle, over the way to its middle, passes a vertex: it is pulled to the middle by that
 * share, so that it never runs through one. Elsewhere nothing is pulled, and no digit lost. */
static const double PULLED = 1e-9;
/* A walk that crosses more edges goes round in circles at a vertex; it is left where it is. */
static const int CROSSINGS_MAX = 20000;

/* A place in the plane of a triangle, with a direction along it, unit. */
typedef struct { int triangle; Vec point, x; } Footing;

typedef struct { double x, y; } Flat;

/* A triangle's corners, two unit directions in its plane, right-handed about its normal, and its corners along these from the
 * first one. */
typedef struct { Vec corner[3], e1, e2; Flat flat[3]; } Plane;

INLINE Vec shortened(Vec v)
{
    double size = length(v);
    return vec(v.x / size, v.y / size, v.z / size);
}

static Plane plane_of(const Surface *s, int triangle)
{
    const int *at = s->triangles + 3 * triangle;
    Plane p;
    for (int k = 0; k < 3; k++) p.corner[k] = vec_at(s->vertices + 3 * at[k]);
    p.e1 = shortened(minus(p.corner[1], p.corner[0]));
    p.e2 = cross(vec_at(s->normals + 3 * triangle), p.e1);
    for (int k = 0; k < 3; k++) {
        Vec own = minus(p.corner[k], p.corner[0]);
        p.flat[k] = (Flat){dot(own, p.e1), dot(own, p.e2)};
    }
    return p;
}

/* Goes over side `side` of `here` into the plane `there` of its neighbour, unfolded about the edge. */
INLINE void turn_over(const Plane *here, int side, const Plane *there, Flat *place, Flat *ahead)
{
    Vec edge = shortened(minus(here->corner[(side + 1) % 3], here->corner[side]));
    Flat in = {dot(edge, here->e1), dot(edge, here->e2)}, out = {dot(edge, there->e1), dot(edge, there->e2)};
    double cosine = out.x * in.x + out.y * in.y, sine = out.y * in.x - out.x * in.y;
    Vec own = minus(here->corner[side], there->corner[0]);
    Flat flat = here->flat[side];
    double shift_x = dot(own, there->e1) - (cosine * flat.x - sine * flat.y);
    double shift_y = dot(own, there->e2) - (sine * flat.x + cosine * flat.y);
    *place = (Flat){cosine * place->x - sine * place->y + shift_x, sine * place->x + cosine * place->y + shift_y};
    *ahead = (Flat){cosine * ahead->x - sine * ahead->y, sine * ahead->x + cosine * ahead->y};
}

/* The side through which a walk leaves a triangle, and how far off that is; the first and infinitely far where it leaves none. */
INLINE int leaves_by(const Plane *p, Flat place, Flat ahead, double *way)
{
    int side = 0;
    *way = INFINITE;
    for (int k = 0; k < 3; k++) {
        Flat from = p->flat[k], to = p->flat[(k + 1) % 3];
        double x = to.x - from.x, y = to.y - from.y, size = root_of(x * x + y * y);
        x /= size;
        y /= size;
        double rate = y * ahead.x + -x * ahead.y;
        if (!(rate > 0.0)) continue;
        double gap = (from.x * y - from.y * x) - y * place.x - -x * place.y;
        if (gap < *way * rate) {
            *way = gap / rate;
            side = k;
        }
    }
    return side;
}

/* Returns where a straight walk ends: `along` the start's x and `beside` along normal x x, metres; x is carried along. */
static Footing walked(const Ground *ground, Footing start, double along, double beside)
{
    int at = start.triangle, pulled = -1;
    double left = root_of(along * along + beside * beside);
    Flat share = left > 0 ? (Flat){along / left, beside / left} : (Flat){1.0, 0.0};
    Plane plane = plane_of(ground->surface, at);
    Vec own = minus(start.point, plane.corner[0]);
    double c = dot(start.x, plane.e1), s = dot(start.x, plane.e2);
    Flat place = {dot(own, plane.e1), dot(own, plane.e2)}, ahead = {c * share.x - s * share.y, s * share.x + c * share.y};
    for (int crossed = 0; left > 0 && crossed < CROSSINGS_MAX; crossed++) {
        double way;
        int side = leaves_by(&plane, place, ahead, &way), over = ground->over[3 * at + side];
        if (way < left && pulled != at) {
            const Flat *f = plane.flat;
            Flat middle = {(f[0].x + f[1].x + f[2].x) / 3.0, (f[0].y + f[1].y + f[2].y) / 3.0};
            if (size_of(way) < PULLED * (size_of(middle.x - place.x) + size_of(middle.y - place.y))) {
                place = (Flat){place.x + PULLED * (middle.x - place.x), place.y + PULLED * (middle.y - place.y)};
                pulled = at;
                continue;
            }
        }
        /* Below zero from past the rim, and by rounding. */
        way = larger(way, 0.0);
        if (way >= left || over < 0) {
            place = (Flat){place.x + left * ahead.x, place.y + left * ahead.y};
            break;
        }
        place = (Flat){place.x + way * ahead.x, place.y + way * ahead.y};
        Plane next = plane_of(ground->surface, over);
        turn_over(&plane, side, &next, &place, &ahead);
        plane = next;
        left -= way;
        at = over;
    }
    /* The start's x is the way turned back by its angle. */
    double x = share.x * ahead.x + share.y * ahead.y, y = share.x * ahead.y - share.y * ahead.x;
    Vec point = plus(plus(plane.corner[0], times(place.x, plane.e1)), times(place.y, plane.e2));
    return (Footing){at, point, plus(times(x, plane.e1), times(y, plane.e2))};
}

#endif
