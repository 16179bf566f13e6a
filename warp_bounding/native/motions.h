// Whole motions: whether no body of an arm comes near an obstacle, or near another body of it, on the way between two
// configurations. C99 that C++ and CUDA read, too: plain functions and arrays. `arms/motions.py` says what is proven,
// and lays out the arrays.

/// MOTIONS
enum { JOINTS = 64, MANY = 8, DEEPEST = 24, ROUNDS = 32 }; // MANY: items of an interval that are kept apart
enum { CLEAR = 0, OPEN = 1, HIT = 2, STUCK = 3 }; // STUCK: open, and halving does not help
enum { HULL = 0, CYLINDER = 1, FIELD = 2 };
enum { HALVINGS = 30, FINEST = 8 }; // of the box around a core: how often it is halved, and into what share of it

// An arm and what is around it. Bodies are those of the arm, then the obstacles. A body is a convex core and all within
// its radius. The core is the hull of corners, or a cylinder. Obstacles may be fields: distances at the nodes of a grid.
typedef struct {
    int joints, coordinates, of_arm, bodies, selves, nodes;
    const int *parent, *slides, *coordinate; // of each joint; the base is the parent -1
    const int *link, *kind, *corners;        // of each body; where its groups of eight corners begin, and the last ends
    const int *first, *path;                 // of each arm's body, then of each pair: joints that move it
    const int *pair;                         // bodies of the arm that are checked against each other
    const int *skip, *group;                 // of each node of the obstacles' tree: the next one but those below, and
                                             // the number of its obstacles' group of eight, or -1
    const double *box;                       // of each node: lower and upper corner of a box around its obstacles
    const double *factor, *offset;           // of each joint: value = factor q[coordinate] + offset
    const double *origin;                    // twelve each: rotation by rows, then place; joints move about or along z
    const double *frame;                     // of each body: the same, of a box or cylinder around its core
    const double *half;                      // three each: half the sides of the box; radius twice, and half the length
    const double *radius, *ball;             // of a ball around the core: centre and radius
    const double *velocity;                  // of each body, for a motion: obstacles may move
    const double *reach;                     // of each joint of a path: how far the body is from its axis at most
    const double *lanes;                     // x, y, z of eight corners, one behind another; of a field half the sides
                                             // of its box, nodes a metre and their number along each axis; distances
    double margin, allowance;
} Cell;

static Cell cell_of(const int *whole, const double *numbers) {
    Cell c;
    const int *at = whole + 6, *places = whole + 6 + 11;
    c.joints = whole[0], c.coordinates = whole[1], c.of_arm = whole[2], c.bodies = whole[3], c.selves = whole[4];
    c.nodes = whole[5];
    c.parent = whole + at[0], c.slides = whole + at[1], c.coordinate = whole + at[2];
    c.link = whole + at[3], c.kind = whole + at[4], c.corners = whole + at[5];
    c.first = whole + at[6], c.path = whole + at[7], c.pair = whole + at[8];
    c.skip = whole + at[9], c.group = whole + at[10], c.box = numbers + places[10];
    c.factor = numbers + places[0], c.offset = numbers + places[1], c.origin = numbers + places[2];
    c.frame = numbers + places[3], c.half = numbers + places[4], c.radius = numbers + places[5];
    c.ball = numbers + places[6], c.velocity = numbers + places[7], c.reach = numbers + places[8];
    c.lanes = numbers + places[9];
    c.margin = numbers[0], c.allowance = numbers[1];
    return c;
}

static double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const double *a, const double *b, double *c) {
    c[0] = a[1] * b[2] - a[2] * b[1], c[1] = a[2] * b[0] - a[0] * b[2], c[2] = a[0] * b[1] - a[1] * b[0];
}

static void place(const double *pose, const double *p, double *q) {
    for (int i = 0; i < 3; ++i) q[i] = dot(pose + 3 * i, p) + pose[9 + i];
}

static void turn(const double *pose, const double *d, double *e) {
    for (int i = 0; i < 3; ++i) e[i] = dot(pose + 3 * i, d);
}

static void turn_back(const double *pose, const double *d, double *e) {
    for (int i = 0; i < 3; ++i) e[i] = pose[i] * d[0] + pose[3 + i] * d[1] + pose[6 + i] * d[2];
}

// Poses of the links, twelve numbers each, and how they move, six each: a point p by cross(w, p) + u. The first ones
// are those of the base.
static void links_at(const Cell *c, const double *q0, const double *dq, double t, double *poses, double *twists) {
    for (int k = 0; k < 12; ++k) poses[k] = k == 0 || k == 4 || k == 8;
    for (int k = 0; k < 6; ++k) twists[k] = 0.0;
    for (int i = 0; i < c->joints; ++i) {
        const double *o = c->origin + 12 * i, *above = poses + 12 * (c->parent[i] + 1);
        double *pose = poses + 12 * (i + 1), *twist = twists + 6 * (i + 1), axis[3], moment[3];
        const double rate = dq[c->coordinate[i]] * c->factor[i];
        const double value = (q0[c->coordinate[i]] + t * dq[c->coordinate[i]]) * c->factor[i] + c->offset[i];
        for (int k = 0; k < 6; ++k) twist[k] = twists[6 * (c->parent[i] + 1) + k];
        place(above, o + 9, pose + 9);
        for (int r = 0; r < 3; ++r)
            for (int k = 0; k < 3; ++k)
                pose[3 * r + k] = above[3 * r] * o[k] + above[3 * r + 1] * o[3 + k] + above[3 * r + 2] * o[6 + k];
        for (int r = 0; r < 3; ++r) axis[r] = pose[3 * r + 2];
        if (c->slides[i]) {
            for (int r = 0; r < 3; ++r) pose[9 + r] += value * axis[r], twist[3 + r] += rate * axis[r];
            continue;
        }
        const double cosine = cos(value), sine = sin(value);
        for (int r = 0; r < 3; ++r) {
            const double x = pose[3 * r], y = pose[3 * r + 1];
            pose[3 * r] = x * cosine + y * sine, pose[3 * r + 1] = y * cosine - x * sine;
        }
        cross(pose + 9, axis, moment);
        for (int r = 0; r < 3; ++r) twist[r] += rate * axis[r], twist[3 + r] += rate * moment[r];
    }
}

// Half the largest acceleration of a body, or of one body of a pair against the other.
static double bend_of(const Cell *c, const double *dq, int which) {
    double turned = 0.0, bend = 0.0; // what the joints nearer to the base turn by
    for (int k = c->first[which]; k < c->first[which + 1]; ++k) {
        const int i = c->path[k];
        const double rate = fabs(dq[c->coordinate[i]] * c->factor[i]);
        bend += rate * c->reach[k] * (turned + (c->slides[i] ? 0.0 : 0.5 * rate));
        turned += c->slides[i] ? 0.0 : rate;
    }
    return bend;
}

// The point of a body's core that lies farthest in a direction.
static void farthest(const Cell *c, const double *poses, double t, int body, const double *direction, double *point) {
    const double *pose = poses + 12 * (c->link[body] + 1);
    double d[3], p[3];
    turn_back(pose, direction, d);
    if (c->kind[body] == CYLINDER) {
        const double *frame = c->frame + 12 * body, *half = c->half + 3 * body;
        double e[3];
        turn_back(frame, d, e);
        const double across = sqrt(e[0] * e[0] + e[1] * e[1]), share = across > 0.0 ? half[0] / across : 0.0;
        e[0] *= share, e[1] *= share, e[2] = e[2] < 0.0 ? -half[2] : half[2];
        place(frame, e, p);
    } else {
        const double *x = c->lanes + c->corners[body], *end = c->lanes + c->corners[body + 1];
#if defined(__clang__) && defined(__cplusplus) && !defined(__CUDA_ARCH__)
        typedef double V __attribute__((vector_size(64), aligned(8)));
        typedef long long I __attribute__((vector_size(64)));
        V most = *(const V *)x * d[0] + *(const V *)(x + 8) * d[1] + *(const V *)(x + 16) * d[2];
        I at = {0, 1, 2, 3, 4, 5, 6, 7}, best = at;
        for (const double *y = x + 24; y < end; y += 24) {
            const V value = *(const V *)y * d[0] + *(const V *)(y + 8) * d[1] + *(const V *)(y + 16) * d[2];
            at += 24;
            best = value > most ? at : best;
            most = value > most ? value : most;
        }
        int lane = 0;
        for (int k = 1; k < 8; ++k)
            if (most[k] > most[lane]) lane = k;
        const double *corner = x + best[lane];
#else
        double most = -1e300;
        const double *corner = x;
        for (; x < end; x += 24)
            for (int k = 0; k < 8; ++k) {
                const double value = x[k] * d[0] + x[8 + k] * d[1] + x[16 + k] * d[2];
                if (value > most) most = value, corner = x + k;
            }
#endif
        p[0] = corner[0], p[1] = corner[8], p[2] = corner[16];
    }
    place(pose, p, point);
    for (int k = 0; k < 3; ++k) point[k] += t * c->velocity[3 * body + k];
}

// How far a point is from the box or cylinder around a body's core, and the direction from there to the point.
static double away_from(const Cell *c, const double *poses, double t, int body, const double *point,
                        double *direction) {
    const double *pose = poses + 12 * (c->link[body] + 1), *frame = c->frame + 12 * body, *half = c->half + 3 * body;
    double p[3], x[3], e[3];
    for (int k = 0; k < 3; ++k) p[k] = point[k] - pose[9 + k] - t * c->velocity[3 * body + k];
    turn_back(pose, p, x);
    for (int k = 0; k < 3; ++k) x[k] -= frame[9 + k];
    turn_back(frame, x, e);
    if (c->kind[body] == CYLINDER) {
        const double across = sqrt(e[0] * e[0] + e[1] * e[1]);
        const double share = across > half[0] ? (across - half[0]) / across : 0.0;
        e[0] *= share, e[1] *= share;
    } else {
        for (int k = 0; k < 2; ++k) e[k] = e[k] > half[k] ? e[k] - half[k] : e[k] < -half[k] ? e[k] + half[k] : 0.0;
    }
    e[2] = e[2] > half[2] ? e[2] - half[2] : e[2] < -half[2] ? e[2] + half[2] : 0.0;
    const double away = sqrt(dot(e, e));
    if (!(away > 1e-150)) return 0.0;
    for (int k = 0; k < 3; ++k) e[k] /= away;
    turn(frame, e, x);
    turn(pose, x, direction);
    return away;
}

// The largest value of a direction over the box or cylinder around a body's core, from the middle of that.
static double extent(const Cell *c, const double *poses, int body, const double *direction) {
    const double *half = c->half + 3 * body;
    double d[3], e[3];
    turn_back(poses + 12 * (c->link[body] + 1), direction, d);
    turn_back(c->frame + 12 * body, d, e);
    if (c->kind[body] == CYLINDER) return half[0] * sqrt(e[0] * e[0] + e[1] * e[1]) + half[2] * fabs(e[2]);
    return half[0] * fabs(e[0]) + half[1] * fabs(e[1]) + half[2] * fabs(e[2]);
}

// The search for a direction that tells two cores apart (Gilbert, Johnson, Keerthi 1988) keeps up to four differences.

static void on_segment(const double *a, const double *b, double *p) {
    double way[3];
    for (int k = 0; k < 3; ++k) way[k] = b[k] - a[k];
    const double square = dot(way, way);
    double t = square > 1e-150 ? -dot(a, way) / square : 0.0;
    t = t > 0.0 ? (t < 1.0 ? t : 1.0) : 0.0;
    for (int k = 0; k < 3; ++k) p[k] = a[k] + t * way[k];
}

static void nearer(double *p, const double *q) {
    if (dot(q, q) < dot(p, p)) p[0] = q[0], p[1] = q[1], p[2] = q[2];
}

static void on_triangle(const double *a, const double *b, const double *c, double *p) {
    double q[3], ab[3], ac[3], n[3], edge[3];
    on_segment(a, b, p), on_segment(b, c, q), nearer(p, q), on_segment(c, a, q), nearer(p, q);
    for (int k = 0; k < 3; ++k) ab[k] = b[k] - a[k], ac[k] = c[k] - a[k];
    cross(ab, ac, n);
    const double square = dot(n, n);
    if (!(square > 1e-150)) return;
    cross(b, c, edge);
    if (!(dot(n, edge) >= 0.0)) return;
    cross(c, a, edge);
    if (!(dot(n, edge) >= 0.0)) return;
    cross(a, b, edge);
    if (!(dot(n, edge) >= 0.0)) return;
    const double share = dot(n, a) / square;
    for (int k = 0; k < 3; ++k) q[k] = n[k] * share;
    nearer(p, q);
}

// How far 0 is from a face's plane, positive on the fourth corner's side; negative where the four are nearly flat.
static double inward(const double *a, const double *b, const double *c, const double *d, double size) {
    double ab[3], ac[3], n[3];
    for (int k = 0; k < 3; ++k) ab[k] = b[k] - a[k], ac[k] = c[k] - a[k];
    cross(ab, ac, n);
    const double length = sqrt(dot(n, n));
    if (!(length > 1e-150)) return -size;
    const double level = dot(n, a) / length, height = dot(n, d) / length - level;
    if (!(fabs(height) > size / 4096)) return -size;
    return height < 0.0 ? level : -level;
}

// How deep 0 lies in the hull of four differences at least; see ``kernels._depth``.
static double depth_of(double s[4][3]) {
    double size = 0.0, least;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < i; ++j) {
            double d[3];
            for (int k = 0; k < 3; ++k) d[k] = s[i][k] - s[j][k];
            if (dot(d, d) > size) size = dot(d, d);
        }
    size = sqrt(size), least = size;
    for (int i = 0; i < 4; ++i) {
        const double in = inward(s[i], s[(i + 1) % 4], s[(i + 2) % 4], s[(i + 3) % 4], size);
        if (in < least) least = in;
    }
    return least - size / (1 << 20);
}

// A direction that is at right angles to the hull of up to three differences.
static void across(double s[4][3], int count, double *n) {
    double a[3], b[3];
    for (int k = 0; k < 3; ++k) {
        a[k] = count > 1 ? s[1][k] - s[0][k] : 0.0;
        b[k] = count > 2 ? s[2][k] - s[0][k] : 0.0;
    }
    int least = fabs(a[0]) < fabs(a[1]) ? 0 : 1;
    if (fabs(a[2]) < fabs(a[least])) least = 2;
    if (count < 3) b[least] = 1.0;
    cross(a, b, n);
    if (!(dot(n, n) > 1e-150)) n[0] = 1.0, n[1] = n[2] = 0.0;
}

// A lower bound of the distance from a point to what a field is of. It lies in the field's box, in which the distance is
// no less than what is linear along each axis between nodes.
static double away_from_field(const Cell *c, int body, const double *point) {
    const double *frame = c->frame + 12 * body, *x = c->lanes + c->corners[body], *value = x + 9;
    double e[3], p[3], share[3], beyond = 0.0;
    int at = 0;
    const int step[3] = {(int)x[7] * (int)x[8], (int)x[8], 1};
    for (int k = 0; k < 3; ++k) p[k] = point[k] - frame[9 + k];
    turn_back(frame, p, e);
    for (int k = 0; k < 3; ++k) {
        p[k] = e[k] > x[k] ? x[k] : e[k] < -x[k] ? -x[k] : e[k];
        beyond += (e[k] - p[k]) * (e[k] - p[k]);
        share[k] = (p[k] + x[k]) * x[3 + k];
        const int cell = share[k] < x[6 + k] - 1.0 ? (int)share[k] : (int)x[6 + k] - 2;
        share[k] -= cell, at += cell * step[k];
    }
    double f[4];
    for (int i = 0; i < 4; ++i) {
        const double *y = value + at + (i & 1) * step[1] + (i >> 1) * step[0];
        f[i] = y[0] + share[2] * (y[1] - y[0]);
    }
    f[0] += share[1] * (f[1] - f[0]), f[2] += share[1] * (f[3] - f[2]);
    f[0] += share[0] * (f[2] - f[0]);
    return sqrt(beyond + (f[0] > 0.0 ? f[0] * f[0] : 0.0));
}

// The same as ``state_of`` of a field a, by balls around the box around the core of b, which is halved. Points of a ball
// are no faster than its centre by more than what turns them about it.
static int field_state(const Cell *c, const double *poses, const double *twists, double t, int a, int b, double h,
                       double bend, double tolerance) {
    const double *pose = poses + 12 * (c->link[b] + 1), *w = twists + 6 * (c->link[b] + 1);
    const double *velocity = c->velocity + 3 * a, *half = c->half + 3 * b, turning = sqrt(dot(w, w));
    double boxes[HALVINGS + 1][6], least = sqrt(dot(half, half)) / FINEST;
    int still[HALVINGS + 1], count = 1; // whether a box is clear at t, by itself or within a larger one
    for (int k = 0; k < 3; ++k) boxes[0][k] = 0.0, boxes[0][3 + k] = half[k];
    still[0] = 0;
    while (count) {
        double *box = boxes[--count], *next = boxes[count + 1], x[3], y[3], v[3];
        const double radius = sqrt(dot(box + 3, box + 3)), need = radius + c->radius[b] + c->margin + tolerance;
        place(c->frame + 12 * b, box, y), place(pose, y, x);
        cross(w, x, v);
        for (int k = 0; k < 3; ++k) v[k] += w[3 + k] - velocity[k], x[k] -= t * velocity[k];
        const double away = away_from_field(c, a, x);
        if (away > need + h * (sqrt(dot(v, v)) + turning * radius + h * bend)) continue;
        if (away > need) still[count] = 1;
        if (radius <= least || count == HALVINGS) return still[count] ? OPEN : STUCK;
        int longest = box[3] < box[4] ? 4 : 3;
        if (box[longest] < box[5]) longest = 5;
        box[longest] *= 0.5;
        for (int k = 0; k < 6; ++k) next[k] = box[k];
        box[longest - 3] -= box[longest], next[longest - 3] += box[longest];
        still[count + 1] = still[count], count += 2;
    }
    return CLEAR;
}

// The least value that a direction n takes in the box around b, moving by cross(w, p) + u, at all times within h.
static double least_in_box(const Cell *c, const double *poses, int b, const double *w, const double *u, double h,
                           const double *n) {
    double x[3], y[3], v[3], least = 1e300;
    place(poses + 12 * (c->link[b] + 1), c->frame + 12 * b + 9, x);
    cross(n, w, y);
    for (int side = -1; side <= 1; side += 2) {
        for (int k = 0; k < 3; ++k) v[k] = n[k] + side * h * y[k];
        const double low = dot(v, x) + side * h * dot(n, u) - extent(c, poses, b, v);
        if (low < least) least = low;
    }
    return least;
}

// Whether bodies a and b, b moving against a, are apart for all times within h of the present one, t. ``center`` is
// that of the ball around b, ``bend`` half its largest acceleration.
static int state_of(const Cell *c, const double *poses, const double *twists, double t, int a, int b, double h,
                    const double *center, double bend, double tolerance) {
    const double *wa = twists + 6 * (c->link[a] + 1), *wb = twists + 6 * (c->link[b] + 1);
    const double solid = c->radius[a] + c->radius[b] + c->margin, need = solid + tolerance + h * h * bend;
    const double ball = c->ball[4 * b + 3];
    double w[3], u[3], n[3], v[3], s[4][3], x[3], y[3], nearest[3], wider = need;
    for (int k = 0; k < 3; ++k) w[k] = wb[k] - wa[k], u[k] = wb[3 + k] - wa[3 + k] - c->velocity[3 * a + k];
    cross(w, center, v);
    place(poses + 12 * (c->link[a] + 1), c->ball + 4 * a, x);
    for (int k = 0; k < 3; ++k) v[k] += u[k], y[k] = center[k] - x[k] - t * c->velocity[3 * a + k];
    const double both = need + ball + c->ball[4 * a + 3] + h * sqrt(dot(v, v));
    if (dot(y, y) > both * both) return CLEAR; // balls around both
    if (c->kind[a] == FIELD) {
        for (int k = 0; k < 3; ++k) x[k] = center[k] - t * c->velocity[3 * a + k];
        if (away_from_field(c, a, x) > need + ball + h * sqrt(dot(v, v))) return CLEAR;
        return field_state(c, poses, twists, t, a, b, h, bend, tolerance);
    }
    const double away = away_from(c, poses, t, a, center, nearest);
    if (away > 0.0) {
        const double left = away - h * fabs(dot(nearest, v)) - need;
        if (left > ball) return CLEAR;
        // the same with the box around b, of which the linear function is no larger anywhere in the core
        if (least_in_box(c, poses, b, w, u, h, nearest) - dot(nearest, center) + away > need) return CLEAR;
        if (left < 0.0 && away > ball + solid) return OPEN; // no hit, and hardly clear: the search can wait
    } else {
        for (int k = 0; k < 3; ++k) nearest[k] = y[k];
    }
    int count = 0, last = 0;
    for (int round = 0; round < ROUNDS; ++round) {
        double length = sqrt(dot(nearest, nearest));
        if (count > 0 && length <= solid - tolerance) return HIT;
        if (!(length > 1e-150)) {
            if (count > 3) return OPEN;
            across(s, count, nearest), length = sqrt(dot(nearest, nearest));
        }
        for (int k = 0; k < 3; ++k) n[k] = nearest[k] / length, v[k] = -n[k];
        farthest(c, poses, t, a, n, x), farthest(c, poses, t, b, v, y);
        const double top = dot(n, x), gap = dot(n, y) - top;
        if (gap > wider) { // wide enough now: is it for all times?
            double least = gap, turned[3];
            cross(n, w, turned);
            for (int side = -1; side <= 1 && h > 0.0; side += 2) {
                double z[3], d[3];
                for (int k = 0; k < 3; ++k) d[k] = -n[k] - side * h * turned[k];
                farthest(c, poses, t, b, d, z);
                const double low = side * h * dot(n, u) - dot(d, z) - top;
                if (low < least) least = low;
            }
            if (least > need) return CLEAR;
            wider = need + 1.1 * (gap - need);
        }
        if (count > 0 && gap > solid - tolerance && (length <= need || length - gap <= 1e-10 * length)) return OPEN;
        if (count < 4) last = count++;
        for (int k = 0; k < 3; ++k) s[last][k] = y[k] - x[k];
        if (count == 1)
            for (int k = 0; k < 3; ++k) nearest[k] = s[0][k];
        else if (count == 2)
            on_segment(s[0], s[1], nearest);
        else if (count == 3)
            on_triangle(s[0], s[1], s[2], nearest);
        else {
            if (depth_of(s) > tolerance) return HIT;
            double least = 1e300; // the corner that is not of the nearest face is the next to give way
            for (int i = 0; i < 4; ++i) {
                double p[3];
                on_triangle(s[(i + 1) % 4], s[(i + 2) % 4], s[(i + 3) % 4], p);
                if (dot(p, p) < least) {
                    least = dot(p, p), last = i;
                    for (int k = 0; k < 3; ++k) nearest[k] = p[k];
                }
            }
        }
    }
    return OPEN;
}

// Bodies of an item: first those of the arm against obstacles, then each pair.
static void bodies_of(const Cell *c, int item, int *a, int *b, int *path) {
    const int around = c->bodies - c->of_arm, pair = item - c->of_arm * around;
    *a = pair < 0 ? c->of_arm + item % around : c->pair[2 * pair];
    *b = pair < 0 ? item / around : c->pair[2 * pair + 1];
    *path = pair < 0 ? *b : c->of_arm + pair;
}

static int item_state(const Cell *c, const double *poses, const double *twists, const double *dq, double t, int item,
                      double h, double tolerance) {
    int a, b, path;
    double center[3];
    bodies_of(c, item, &a, &b, &path);
    place(poses + 12 * (c->link[b] + 1), c->ball + 4 * b, center);
    return state_of(c, poses, twists, t, a, b, h, center, bend_of(c, dq, path), tolerance);
}

// The state of the first item that is not clear, from ``*item`` on. Bodies and obstacles that stand are clear.
static int first_open(const Cell *c, const double *poses, const double *twists, const double *dq, double t, double h,
                      double tolerance, int *item) {
    const int around = c->bodies - c->of_arm, obstacles = c->of_arm * around, all = obstacles + c->selves;
    while (*item < obstacles) {
        const int b = *item / around, begin = *item % around, stands = c->first[b] == c->first[b + 1];
        const double *twist = twists + 6 * (c->link[b] + 1), bend = bend_of(c, dq, b);
        double center[3], v[3];
        place(poses + 12 * (c->link[b] + 1), c->ball + 4 * b, center);
        cross(twist, center, v);
        for (int k = 0; k < 3; ++k) v[k] += twist[3 + k];
        const double need = c->radius[b] + c->margin + tolerance + h * h * bend, ball = c->ball[4 * b + 3];
        const double reach = need + ball + h * sqrt(dot(v, v));
        int node = 0; // of the group at which to go on: the tree has as many nodes on the left as on the right
        for (int size = c->nodes / 2, before = begin / 8; size > 0; size /= 2) {
            const int right = before > size / 2;
            node += right ? 1 + size : 1, before -= right ? size / 2 + 1 : 0;
        }
        node = begin > 0 ? node : 0;
        while (node < c->nodes) {
            const double *low = c->box + 6 * node;
            double off[3];
            for (int k = 0; k < 3; ++k) {
                const double under = center[k] - low[k], over = center[k] - low[3 + k];
                off[k] = under < 0.0 ? under : over > 0.0 ? over : 0.0;
            }
            const double away = sqrt(dot(off, off));
            const int group = c->group[node];
            int clear = away > reach || (group >= 0 && 8 * (group + 1) <= begin);
            if (!clear && away > 1e-150) {
                for (int k = 0; k < 3; ++k) off[k] /= away;
                clear = away - h * fabs(dot(off, v)) > need + ball ||
                        least_in_box(c, poses, b, twist, twist + 3, h, off) - dot(off, center) + away > need;
            }
            if (clear) {
                node = c->skip[node];
                continue;
            }
            ++node;
            if (group < 0) continue;
            for (int k = 8 * group < begin ? begin : 8 * group; k < around && k < 8 * (group + 1); ++k) {
                const int a = c->of_arm + k;
                if (stands && !(dot(c->velocity + 3 * a, c->velocity + 3 * a) > 0.0)) continue;
                const int state = state_of(c, poses, twists, t, a, b, h, center, bend, tolerance);
                if (state == CLEAR) continue;
                *item = b * around + k;
                return state;
            }
        }
        *item = (b + 1) * around;
    }
    for (; *item < all; ++*item) {
        const int state = item_state(c, poses, twists, dq, t, *item, h, tolerance);
        if (state != CLEAR) return state;
    }
    return CLEAR;
}

// Halves a motion until all of it is clear, from its start on; the result is the share that is, and in ``culprit`` what
// was in the way, or -1. ``state`` of what is in the way is OPEN or HIT. If not ``to_the_end``, ends at the first HIT,
// or where halving does not help.
static double segment(const Cell *c, const double *q0, const double *q1, int deepest, int to_the_end, int *state,
                      int *culprit) {
    double poses[12 * (JOINTS + 1)], twists[6 * (JOINTS + 1)], dq[JOINTS], moved = 1.0;
    int items[DEEPEST + 1][MANY], counts[DEEPEST + 1], depth = 0; // of an interval so deep; all where counts is -1
    unsigned position = 0;
    *state = OPEN, *culprit = -1;
    for (int k = 0; k < c->coordinates; ++k) {
        dq[k] = q1[k] - q0[k];
        moved += fabs(dq[k]);
        if (!(fabs(q0[k]) <= 1e3 && fabs(q1[k]) <= 1e3)) return 0.0;
    }
    const double tolerance = c->allowance * moved;
    counts[0] = -1;
    for (;;) {
        const double width = ldexp(1.0, -depth), h = 0.5 * width;
        const double t = (position + 0.5) * width;
        links_at(c, q0, dq, t, poses, twists);
        const int count = counts[depth];
        int open = 0, *halves = items[depth < deepest ? depth + 1 : 0];
        for (int k = 0, item = 0; count < 0 || k < count; ++k, ++item) {
            if (count >= 0) item = items[depth][k];
            const int found = count >= 0 ? item_state(c, poses, twists, dq, t, item, h, tolerance)
                                         : first_open(c, poses, twists, dq, t, h, tolerance, &item);
            if (found == CLEAR && count < 0) break;
            if (found == CLEAR) continue;
            if (depth == deepest || (found >= HIT && !to_the_end)) {
                *state = found == HIT ? HIT : OPEN, *culprit = item;
                return position * width;
            }
            if (open == MANY) { // too many: the halves look at all of them
                open = -1;
                break;
            }
            halves[open++] = item;
        }
        if (open) {
            counts[++depth] = open, position *= 2;
            continue;
        }
        while (depth && position % 2) --depth, position /= 2;
        if (!depth) break;
        ++position;
    }
    *state = CLEAR;
    return 1.0;
}

// Whether a configuration is clear of everything.
static int configuration(const Cell *c, const double *q, int *culprit) {
    double poses[12 * (JOINTS + 1)], twists[6 * (JOINTS + 1)], dq[JOINTS];
    int state = CLEAR;
    *culprit = -1;
    for (int k = 0; k < c->coordinates; ++k) {
        dq[k] = 0.0;
        if (!(fabs(q[k]) <= 1e3)) return OPEN;
    }
    links_at(c, q, dq, 0.0, poses, twists);
    for (int item = 0; state != HIT; ++item) {
        const int found = first_open(c, poses, twists, dq, 0.0, 0.0, c->allowance, &item);
        if (found == CLEAR) break;
        if (state == CLEAR || found == HIT) state = found == HIT ? HIT : OPEN, *culprit = item;
    }
    return state;
}

/// HEADER:
/// What a header of one arm has besides, with $n coordinates; see ``Motions.export``.
// Whether a configuration is within the joints' limits, up to what q0 + t (q1 - q0) rounds; that is taken back in ``at``.
static int within(const double *q, double *at) {
    const double *low = ${name}_limits(), *high = low + $n;
    for (int k = 0; k < $n; ++k) {
        at[k] = q[k] < low[k] ? low[k] : q[k] > high[k] ? high[k] : q[k];
        if (!(fabs(q[k] - at[k]) <= $rounded * (fabs(low[k]) + fabs(high[k])))) return 0;
    }
    return 1;
}

// Whether a cell's arm has this one's joints, whose limits the header has. Bodies and margin are the cell's.
static int of_this_arm(const Cell *c) {
    const Cell own = cell_of(${name}_whole(), ${name}_numbers());
    if (c->joints != own.joints || c->coordinates != own.coordinates) return 0;
    for (int i = 0; i < own.joints; ++i) {
        if (c->parent[i] != own.parent[i] || c->slides[i] != own.slides[i]) return 0;
        if (c->coordinate[i] != own.coordinate[i] || c->factor[i] != own.factor[i]) return 0;
        if (c->offset[i] != own.offset[i]) return 0;
        for (int k = 12 * i; k < 12 * (i + 1); ++k)
            if (c->origin[k] != own.origin[k]) return 0;
    }
    return 1;
}

// Whether a straight motion among other obstacles is proven free: 1 yes, 0 no. ``share`` gets the share of it that is
// proven from its start on, or is NULL, which is faster. ``Motions.cell`` of Python gives ``whole`` and ``numbers``.
static int ${name}_segment_in(const int *whole, const double *numbers, const double q0[$n], const double q1[$n],
                              double *share) {
    double begin[$n], end[$n], proven = 0.0;
    int state = OPEN, culprit;
    const Cell c = cell_of(whole, numbers);
    if (of_this_arm(&c) && within(q0, begin) && within(q1, end))
        proven = segment(&c, begin, end, $halvings, share ? 1 : 0, &state, &culprit);
    if (share) *share = proven;
    return state == CLEAR;
}

// Whether a configuration among other obstacles is free, 0, collides, 2, or neither can be proven, 1.
static int ${name}_configuration_in(const int *whole, const double *numbers, const double q[$n]) {
    double at[$n];
    int culprit;
    const Cell c = cell_of(whole, numbers);
    return of_this_arm(&c) && within(q, at) ? configuration(&c, at, &culprit) : OPEN;
}

// The same two among the obstacles that are named on top.
static int ${name}_segment(const double q0[$n], const double q1[$n], double *share) {
    return ${name}_segment_in(${name}_whole(), ${name}_numbers(), q0, q1, share);
}

static int ${name}_configuration(const double q[$n]) {
    return ${name}_configuration_in(${name}_whole(), ${name}_numbers(), q);
}
