/* The sweep along a chain of knots, its back substitution, and the covariances (geograph/sweep.py). */

/* What is kept of each interval: back and spread; these and the noise's inverse root and gain; or the
   inverse root and the rows of the noise, of which the others are made when they are asked for. */
enum { TURNED = 0, ALL = 1, LATER = 2 };

typedef struct {
    Size n, d, c; /* intervals; components of a knot; constants and the gradient */
    int ends, kept;
    double damping;
    const double *knot, *blocks, *others, *inverse_transition, *noise_root, *noise_residual;
    double *knots, *shares, *back, *spread, *sums, *inverse_roots, *gain;
} Sweep;

/* Rows of the work space: all are padded to whole registers, p = PADDED(d), q = PADDED(d + c). */
typedef struct {
    double *turn;     /* d x p: A L, x[k] = A x[k+1] - A L w */
    double *turned;   /* d x p: its transpose times the knot's information */
    double *given;    /* d x (p + q): -(information) A L, and what is said of x[k] over x[k+1], others */
    double *noise;    /* d x (p + q): the same of the noise */
    double *inverse;  /* d x p */
    double *rest;     /* d x q */
    double *gain;     /* d x q */
    double *total;    /* q x q: rows of x[k+1], then of the constants and the gradient */
    double *crossed;  /* d x p */
} Room;

static Size room_for(Size d, Size c)
{
    Size p = PADDED(d), q = PADDED(d + c);
    return d * (5 * p + 2 * (p + q) + 2 * q) + (q + 4) * q;
}

static void lay_out_room(Size d, Size c, double *work, Room *room)
{
    Size p = PADDED(d), q = PADDED(d + c);
    room->turn = work;
    room->turned = room->turn + d * p;
    room->crossed = room->turned + d * p;
    room->inverse = room->crossed + d * p;
    room->given = room->inverse + d * p;
    room->noise = room->given + d * (p + q);
    room->rest = room->noise + d * (p + q);
    room->gain = room->rest + d * q;
    room->total = room->gain + d * q;
}

static inline void mirror(Size size, double *matrix)
{
    for (Size i = 0; i < size; i++)
        for (Size j = 0; j < i; j++)
            matrix[j * size + i] = matrix[i * size + j];
}

/* b = A L, whose rows and A's are mostly zeros. */
INLINE void turn_root(Size d, Size p, const double *a, const double *root, double *turn)
{
    memset(turn, 0, sizeof(double) * (size_t)(d * p));
    for (Size i = 0; i < d; i++)
        for (Size j = 0; j < d; j++) {
            double by = a[i * d + j];
            if (by == 0.0)
                continue;
            for (Size m = 0; m < d; m++)
                turn[i * p + m] += by * root[j * d + m];
        }
}

/* gain = R^-T rest, back = A + b gain, spread = b R^-T. */
INLINE void turn_back(Size d, Size c, const double *a, const double *turn, const double *inverse,
                      const double *rest, double *gain, double *back, double *spread)
{
    Size p = PADDED(d), w = d + c, q = PADDED(w);
    memset(gain, 0, sizeof(double) * (size_t)(d * q));
    for (Size i = 0; i < d; i++)
        for (Size m = 0; m <= i; m++)
            add_row(q, inverse[i * p + m], rest + i * q, gain + m * q);
    memset(spread, 0, sizeof(double) * (size_t)(d * d));
    double row[64], *held = w <= 60 ? row : NULL;
    for (Size i = 0; i < d; i++) {
        double *to = back + i * w;
        if (held != NULL) {
            memset(held, 0, sizeof(double) * (size_t)q);
            for (Size m = 0; m < d; m++)
                if (turn[i * p + m] != 0.0)
                    add_row(q, turn[i * p + m], gain + m * q, held);
            memcpy(to, held, sizeof(double) * (size_t)w);
        } else {
            memset(to, 0, sizeof(double) * (size_t)w);
            for (Size m = 0; m < d; m++)
                if (turn[i * p + m] != 0.0)
                    for (Size j = 0; j < w; j++)
                        to[j] += turn[i * p + m] * gain[m * q + j];
        }
        for (Size j = 0; j < d; j++)
            to[j] += a[i * d + j];
        for (Size m = 0; m < d; m++) {
            double by = turn[i * p + m];
            if (by == 0.0)
                continue;
            /* Rows of the inverse are columns here. */
            for (Size j = m; j < d; j++)
                spread[i * d + j] += by * inverse[j * p + m];
        }
    }
}

/* One interval: rows of knot k (d x q), "knot", become those of knot k + 1 in the room's total. */
INLINE int sweep_step(Size d, const Sweep *all, Size k, double *knot, const Room *room)
{
    Size c = all->c, w = d + c, full = 2 * d + c, p = PADDED(d), q = PADDED(w), g = p + q;
    const double *block = all->blocks + k * 2 * d * full;
    const double *a = all->inverse_transition + k * d * d;
    double *turn = room->turn, *turned = room->turned, *crossed = room->crossed;
    double *given = room->given, *noise = room->noise, *rest = room->rest, *total = room->total;
    turn_root(d, p, a, all->noise_root + k * d * d, turn);
    /* The information of x[k], in knot's first columns; transitions are taken as rows of "by", which
       skips their zeros, and what comes of them is turned: (p b)' = b' p. */
    for (Size i = 0; i < d; i++) {
        for (Size j = 0; j < d; j++)
            knot[i * q + j] += block[i * full + j];
        knot[i * q + i] += all->damping;
    }
    memset(turned, 0, sizeof(double) * (size_t)(2 * d * p)); /* and crossed, behind it */
    for (Size i = 0; i < d; i++)
        for (Size m = 0; m < d; m++) {
            double by = turn[i * p + m];
            if (by != 0.0)
                for (Size j = 0; j < d; j++)
                    turned[m * p + j] += by * knot[i * q + j];
        }
    for (Size i = 0; i < d; i++)
        for (Size j = 0; j < d; j++)
            given[j * g + i] = turned[i * p + j];
    memset(turned, 0, sizeof(double) * (size_t)(d * p));
    for (Size i = 0; i < d; i++)
        for (Size m = 0; m < d; m++) {
            double by = a[i * d + m];
            if (by == 0.0)
                continue;
            for (Size j = 0; j < d; j++)
                turned[m * p + j] += by * knot[i * q + j];
            for (Size j = 0; j < d; j++)
                crossed[m * p + j] += by * block[i * full + d + j];
        }
    for (Size i = 0; i < d; i++) {
        double *row = given + i * g + p;
        for (Size j = 0; j < d; j++)
            row[j] = turned[j * p + i] + block[i * full + d + j];
        for (Size j = d; j < w; j++)
            row[j] = knot[i * q + j] + block[i * full + d + j];
    }
    /* Of the noise: (I + b' p b), and -b' times the rest beside it; signs are turned at the end. */
    memset(noise, 0, sizeof(double) * (size_t)(d * g));
    for (Size i = 0; i < d; i++)
        for (Size m = 0; m < d; m++)
            if (turn[i * p + m] != 0.0)
                add_row(g, turn[i * p + m], given + i * g, noise + m * g);
    for (Size i = 0; i < d; i++) {
        noise[i * g + i] += 1.0;
        noise[i * g + p + w - 1] -= all->noise_residual[k * d + i];
    }
    /* Of x[k+1]: A' times what is said of x[k], cross' A (turned, as it is) and its own part. */
    for (Size i = 0; i < d; i++) {
        double *row = total + i * q;
        memcpy(row, block + (d + i) * full + d, sizeof(double) * (size_t)w);
        for (Size j = w; j < q; j++)
            row[j] = 0.0;
        for (Size j = 0; j < d; j++)
            row[j] += crossed[j * p + i];
    }
    for (Size i = 0; i < d; i++)
        for (Size m = 0; m < d; m++)
            if (a[i * d + m] != 0.0)
                add_row(q, a[i * d + m], given + i * g + p, total + m * q);
    for (Size i = 0; i < d; i++)
        memcpy(turned + i * p, noise + i * g, sizeof(double) * (size_t)p);
    if (!inverse_root(d, p, turned, room->inverse))
        return 0;
    /* rest = -R^-1 (noise): rows of the inverse end at the diagonal. */
    memset(rest, 0, sizeof(double) * (size_t)(d * q));
    for (Size i = 0; i < d; i++)
        for (Size m = 0; m <= i; m++)
            add_row(q, -room->inverse[i * p + m], noise + m * g + p, rest + i * q);
    take_square(d, q, rest, total);
    for (Size i = 0; i < d; i++)
        for (Size j = 0; j < i; j++)
            total[i * q + j] = total[j * q + i];
    double product = 1.0, sum = 0.0;
    for (Size i = 0; i < d; i++) {
        product *= room->inverse[i * p + i];
        sum += rest[i * q + w - 1] * rest[i * q + w - 1];
    }
    if (product > 1e-250 && product < 1e250)
        all->sums[0] -= log(product);
    else
        for (Size i = 0; i < d; i++)
            all->sums[0] -= log(room->inverse[i * p + i]);
    all->sums[1] += sum;
    return 1;
}

INLINE void keep_step(Size d, const Sweep *all, Size k, const Room *room)
{
    Size w = d + all->c, p = PADDED(d), q = PADDED(w);
    const double *kept = room->rest;
    if (all->kept != LATER) {
        turn_back(d, all->c, all->inverse_transition + k * d * d, room->turn, room->inverse,
                  room->rest, room->gain, all->back + k * d * w, all->spread + k * d * d);
        kept = room->gain;
    }
    if (all->kept == TURNED)
        return;
    for (Size i = 0; i < d; i++) {
        memcpy(all->inverse_roots + (k * d + i) * d, room->inverse + i * p,
               sizeof(double) * (size_t)d);
        memcpy(all->gain + (k * d + i) * w, kept + i * q, sizeof(double) * (size_t)w);
    }
}

INLINE int sweep_of(Size d, const Sweep *all, double *work)
{
    Size c = all->c, w = d + c, q = PADDED(w);
    Room room;
    lay_out_room(d, c, work, &room);
    double *knot = room.total + q * q, *share = room.total + d * q + d;
    memset(work, 0, sizeof(double) * (size_t)(room_for(d, c) + d * q));
    for (Size i = 0; i < d; i++)
        memcpy(knot + i * q, all->knot + i * w, sizeof(double) * (size_t)w);
    for (Size k = 0; k < all->n; k++) {
        if (!all->ends || k == 0)
            for (Size i = 0; i < c; i++)
                memcpy(share + i * q, all->others + (k * c + i) * c, sizeof(double) * (size_t)c);
        if (!sweep_step(d, all, k, knot, &room))
            return 0;
        keep_step(d, all, k, &room);
        memcpy(knot, room.total, sizeof(double) * (size_t)(d * q));
        if (all->ends && k + 1 < all->n)
            continue;
        double *rows = all->knots + (all->ends ? 0 : k) * d * w;
        double *shared = all->shares + (all->ends ? 0 : k) * c * c;
        for (Size i = 0; i < d; i++)
            memcpy(rows + i * w, knot + i * q, sizeof(double) * (size_t)w);
        for (Size i = 0; i < c; i++)
            for (Size j = i; j < c; j++)
                shared[i * c + j] = shared[j * c + i] = share[i * q + j];
    }
    return 1;
}

WIDE static int sweep_all(const Sweep *all, double *work)
{
    /* Loops of known length are unrolled for the usual motions. */
    if (all->d == 9)
        return sweep_of(9, all, work);
    return all->d == 6 ? sweep_of(6, all, work) : sweep_of(all->d, all, work);
}

static PyObject *sweep(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    Sweep all;
    start(&reader, arguments, given);
    Size n = all.n = whole(&reader);
    Size d = all.d = whole(&reader), c = all.c = whole(&reader);
    all.ends = (int)whole(&reader);
    all.kept = (int)whole(&reader);
    all.damping = number(&reader);
    Size w = d + c, full = w + d, held = all.ends ? 1 : n;
    all.knot = reals(&reader, d * w);
    all.blocks = reals(&reader, n * 2 * d * full);
    all.others = reals(&reader, held * c * c);
    all.inverse_transition = reals(&reader, n * d * d);
    all.noise_root = reals(&reader, n * d * d);
    all.noise_residual = reals(&reader, n * d);
    all.knots = results(&reader, held * d * w);
    all.shares = results(&reader, held * c * c);
    all.back = results(&reader, all.kept == LATER ? 0 : n * d * w);
    all.spread = results(&reader, all.kept == LATER ? 0 : n * d * d);
    all.sums = results(&reader, 2);
    all.inverse_roots = results(&reader, all.kept == TURNED ? 0 : n * d * d);
    all.gain = results(&reader, all.kept == TURNED ? 0 : n * d * w);
    int there = all.knot && all.blocks && all.others && all.inverse_transition && all.noise_root &&
                all.noise_residual && all.knots && all.shares && all.back && all.spread && all.sums &&
                all.inverse_roots && all.gain;
    if (!complete(&reader, there)) {
        release(&reader);
        return NULL;
    }
    double *work = malloc(sizeof(double) * (size_t)(room_for(d, c) + d * PADDED(w) + 1));
    if (work == NULL) {
        release(&reader);
        return PyErr_NoMemory();
    }
    int good;
    Py_BEGIN_ALLOW_THREADS
    all.sums[0] = all.sums[1] = 0.0;
    if (all.ends) {
        memcpy(all.shares, all.others, sizeof(double) * (size_t)(c * c));
        if (n == 0)
            memcpy(all.knots, all.knot, sizeof(double) * (size_t)(d * w));
    }
    good = sweep_all(&all, work);
    Py_END_ALLOW_THREADS
    free(work);
    release(&reader);
    return PyBool_FromLong(good);
}

/* Covariances from the last knot on. With the constants known that of a knot is
   V[k] = B V[k+1] B' + spread spread', and its mean moves with them by G[k] = B G[k+1] + C; S is the
   constants' own. Only the sums are kept:

       knots = V + G S G',  cross = G S,  neighbours = B knots[k+1] + C cross[k+1]'. */
typedef struct {
    Size n, d, s;
    const double *back, *spread, *constants;
    double *known, *slope; /* of one knot: of the last on entry, of the first in the end */
    double *knots, *neighbours, *cross;
} Covariances;

/* out (columns x rows) is the transpose of a (rows x columns), whose rows are lda apart. */
/* Of one knot, rows padded: p = PADDED(d), t = PADDED(s). */
typedef struct {
    double *constants;   /* s x t */
    double *slope, *lean; /* p x t, and one to write the next to */
    double *turned;      /* s x p: slope' */
    double *cross;       /* t x p: constants slope' */
    double *known, *own; /* p x p */
    double *by;          /* (d + s) x p: back' */
    double *spread;      /* d x p: spread' */
    double *work;        /* p x p */
} Covering;

static Size room_to_cover(Size d, Size s)
{
    Size p = PADDED(d), t = PADDED(s);
    return s * t + 2 * p * t + s * p + t * p + 3 * p * p + (d + s) * p + d * p;
}

static void lay_out_cover(Size d, Size s, double *room, Covering *now)
{
    Size p = PADDED(d), t = PADDED(s);
    now->constants = room;
    now->slope = now->constants + s * t;
    now->lean = now->slope + p * t;
    now->turned = now->lean + p * t;
    now->cross = now->turned + s * p;
    now->known = now->cross + t * p;
    now->own = now->known + p * p;
    now->work = now->own + p * p;
    now->by = now->work + p * p;
    now->spread = now->by + (d + s) * p;
}

/* out (columns x rows, p apart) = a', a's rows lda apart. */
INLINE void transpose(Size rows, Size columns, const double *a, Size lda, double *restrict out, Size p)
{
    for (Size i = 0; i < rows; i++)
        for (Size j = 0; j < columns; j++)
            out[j * p + i] = a[i * lda + j];
}

/* knots and cross of one knot, from known and slope. */
INLINE void put_covariance(Size d, const Covariances *all, Size k, const Covering *now)
{
    Size s = all->s, p = PADDED(d), t = PADDED(s);
    double *cross = all->cross + k * d * s, *own = all->knots + k * d * d;
    transpose(d, s, now->slope, t, now->turned, p);
    memset(now->cross, 0, sizeof(double) * (size_t)(t * p));
    add_products(s, t, p, now->constants, t, now->turned, p, now->cross, p);
    memcpy(now->own, now->known, sizeof(double) * (size_t)(p * p));
    add_products(s, p, p, now->cross, p, now->turned, p, now->own, p);
    for (Size i = 0; i < d; i++)
        for (Size j = 0; j <= i; j++)
            now->own[i * p + j] = now->own[j * p + i] = own[i * d + j] = own[j * d + i] =
                0.5 * (now->own[i * p + j] + now->own[j * p + i]);
    transpose(s, d, now->cross, p, cross, s);
}

INLINE void marginals_of(Size d, const Covariances *all, double *room)
{
    Size s = all->s, w = d + s + 1, p = PADDED(d), t = PADDED(s);
    Covering now;
    memset(room, 0, sizeof(double) * (size_t)room_to_cover(d, s));
    lay_out_cover(d, s, room, &now);
    for (Size i = 0; i < s; i++)
        memcpy(now.constants + i * t, all->constants + i * s, sizeof(double) * (size_t)s);
    for (Size i = 0; i < d; i++) {
        memcpy(now.slope + i * t, all->slope + i * s, sizeof(double) * (size_t)s);
        memcpy(now.known + i * p, all->known + i * d, sizeof(double) * (size_t)d);
    }
    put_covariance(d, all, all->n, &now);
    for (Size k = all->n - 1; k >= 0; k--) {
        const double *by = all->back + k * d * w;
        double *beside = all->neighbours + k * d * d, *work = now.work;
        transpose(d, d + s, by, w, now.by, p);
        transpose(d, d, all->spread + k * d * d, d, now.spread, p);
        memset(work, 0, sizeof(double) * (size_t)(p * p));
        add_products(d, p, p, now.by, p, now.own, p, work, p);
        add_products(s, p, p, now.by + d * p, p, now.cross, p, work, p);
        for (Size i = 0; i < d; i++)
            memcpy(beside + i * d, work + i * p, sizeof(double) * (size_t)d);
        memset(work, 0, sizeof(double) * (size_t)(p * p));
        add_products(d, p, p, now.known, p, now.by, p, work, p);
        memset(now.known, 0, sizeof(double) * (size_t)(p * p));
        add_products(d, p, p, now.by, p, work, p, now.known, p);
        add_products(d, p, p, now.spread, p, now.spread, p, now.known, p);
        for (Size i = 0; i < d; i++)
            for (Size j = 0; j < i; j++)
                now.known[j * p + i] = now.known[i * p + j];
        for (Size i = 0; i < d; i++)
            memcpy(now.lean + i * t, by + i * w + d, sizeof(double) * (size_t)s);
        add_products(d, p, t, now.by, p, now.slope, t, now.lean, t);
        double *slope = now.slope;
        now.slope = now.lean;
        now.lean = slope;
        put_covariance(d, all, k, &now);
    }
}

WIDE static void marginals_all(const Covariances *all, double *room)
{
    if (all->d == 9)
        marginals_of(9, all, room);
    else if (all->d == 6)
        marginals_of(6, all, room);
    else
        marginals_of(all->d, all, room);
}

static PyObject *marginals(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    Covariances all;
    start(&reader, arguments, given);
    Size n = all.n = whole(&reader), d = all.d = whole(&reader), s = all.s = whole(&reader);
    all.back = reals(&reader, n * d * (d + s + 1));
    all.spread = reals(&reader, n * d * d);
    all.constants = reals(&reader, s * s);
    all.known = results(&reader, d * d);
    all.slope = results(&reader, d * s);
    all.knots = results(&reader, (n + 1) * d * d);
    all.neighbours = results(&reader, n * d * d);
    all.cross = results(&reader, (n + 1) * d * s);
    if (!complete(&reader, all.back && all.spread && all.constants && all.known && all.slope &&
                               all.knots && all.neighbours && all.cross)) {
        release(&reader);
        return NULL;
    }
    double *work = malloc(sizeof(double) * (size_t)(room_to_cover(d, s) + 1));
    if (work == NULL) {
        release(&reader);
        return PyErr_NoMemory();
    }
    Py_BEGIN_ALLOW_THREADS
    marginals_all(&all, work);
    Py_END_ALLOW_THREADS
    free(work);
    release(&reader);
    Py_RETURN_NONE;
}

/* knots[k] = back[k] (knots[k+1], constants, 1), from the last on. */
WIDE static void back_all(Size n, Size d, Size c, const double *back, const double *constants,
                          double *knots)
{
    Size w = d + c;
    for (Size k = n - 1; k >= 0; k--) {
        const double *by = back + k * d * w, *next = knots + (k + 1) * d;
        for (Size i = 0; i < d; i++) {
            double value = by[i * w + w - 1];
            for (Size j = 0; j < d; j++)
                value += by[i * w + j] * next[j];
            for (Size j = 0; j < c - 1; j++)
                value += by[i * w + d + j] * constants[j];
            knots[k * d + i] = value;
        }
    }
}

static PyObject *substitute(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size n = whole(&reader), d = whole(&reader), c = whole(&reader);
    const double *back = reals(&reader, n * d * (d + c));
    const double *constants = reals(&reader, c - 1);
    double *knots = results(&reader, (n + 1) * d);
    if (!complete(&reader, back && constants && knots && c > 0)) {
        release(&reader);
        return NULL;
    }
    Py_BEGIN_ALLOW_THREADS
    back_all(n, d, c, back, constants, knots);
    Py_END_ALLOW_THREADS
    release(&reader);
    Py_RETURN_NONE;
}

/* x[k] = A (x[k+1] + L R^-T rest (x[k+1], constants, 1)): what back says, from what it is made of. */
typedef struct {
    Size n, d, c;
    const double *inverse_transition, *noise_root, *inverse_roots, *rests, *constants;
    double *knots, *back, *spread;
} Later;

INLINE double dot_of(Size n, const double *a, const double *b)
{
    double value = 0.0;
    Size i = 0;
#ifdef FOUR
    Four sum = {0.0, 0.0, 0.0, 0.0};
    for (; i + 4 <= n; i += 4)
        sum += FOUR(a + i) * FOUR(b + i);
    value = (sum[0] + sum[1]) + (sum[2] + sum[3]);
#endif
    for (; i < n; i++)
        value += a[i] * b[i];
    return value;
}

INLINE void substitute_of(Size d, const Later *all, double *work)
{
    Size c = all->c, w = d + c;
    double *known = work, *turned = work + w;
    memcpy(known + d, all->constants, sizeof(double) * (size_t)(c - 1));
    known[w - 1] = 1.0;
    for (Size k = all->n - 1; k >= 0; k--) {
        const double *inverse = all->inverse_roots + k * d * d, *rest = all->rests + k * d * w;
        const double *a = all->inverse_transition + k * d * d, *root = all->noise_root + k * d * d;
        double *x = all->knots + k * d;
        memcpy(known, x + d, sizeof(double) * (size_t)d);
        memset(turned, 0, sizeof(double) * (size_t)d);
        for (Size i = 0; i < d; i++) {
            double value = dot_of(w, rest + i * w, known);
            for (Size j = 0; j <= i; j++)
                turned[j] += inverse[i * d + j] * value;
        }
        for (Size i = 0; i < d; i++)
            known[i] += dot_of(d, root + i * d, turned);
        for (Size i = 0; i < d; i++)
            x[i] = dot_of(d, a + i * d, known);
    }
}

WIDE static void substitute_later_all(const Later *all, double *work)
{
    if (all->d == 9)
        substitute_of(9, all, work);
    else
        substitute_of(all->d, all, work);
}

WIDE static void turn_back_all(const Later *all, double *work)
{
    Size d = all->d, c = all->c, w = d + c, p = PADDED(d), q = PADDED(w);
    double *turn = work, *inverse = turn + d * p, *rest = inverse + d * p, *gain = rest + d * q;
    memset(work, 0, sizeof(double) * (size_t)(2 * d * (p + q)));
    for (Size k = 0; k < all->n; k++) {
        const double *a = all->inverse_transition + k * d * d;
        turn_root(d, p, a, all->noise_root + k * d * d, turn);
        for (Size i = 0; i < d; i++) {
            memcpy(inverse + i * p, all->inverse_roots + (k * d + i) * d,
                   sizeof(double) * (size_t)d);
            memcpy(rest + i * q, all->rests + (k * d + i) * w, sizeof(double) * (size_t)w);
        }
        turn_back(d, c, a, turn, inverse, rest, gain, all->back + k * d * w,
                  all->spread + k * d * d);
    }
}

/* Arguments that both share, and room to work in; NULL with an error set. */
static double *later(Reader *reader, Later *all)
{
    Size n = all->n = whole(reader), d = all->d = whole(reader), c = all->c = whole(reader);
    Size w = d + c;
    all->inverse_transition = reals(reader, n * d * d);
    all->noise_root = reals(reader, n * d * d);
    all->inverse_roots = reals(reader, n * d * d);
    all->rests = reals(reader, n * d * w);
    if (reader->failed)
        return NULL;
    double *work = malloc(sizeof(double) * (size_t)(2 * d * (PADDED(d) + PADDED(w)) + w + d + 1));
    if (work == NULL) {
        PyErr_NoMemory();
        reader->failed = 1;
    }
    return work;
}

static PyObject *substitute_later(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    Later all;
    start(&reader, arguments, given);
    double *work = later(&reader, &all);
    all.constants = reals(&reader, all.c - 1);
    all.knots = results(&reader, (all.n + 1) * all.d);
    int there = all.inverse_transition && all.noise_root && all.inverse_roots && all.rests &&
                all.constants && all.knots;
    if (!complete(&reader, there)) {
        free(work);
        release(&reader);
        return NULL;
    }
    Py_BEGIN_ALLOW_THREADS
    substitute_later_all(&all, work);
    Py_END_ALLOW_THREADS
    free(work);
    release(&reader);
    Py_RETURN_NONE;
}

static PyObject *turn_back_later(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    Later all;
    start(&reader, arguments, given);
    double *work = later(&reader, &all);
    all.back = results(&reader, all.n * all.d * (all.d + all.c));
    all.spread = results(&reader, all.n * all.d * all.d);
    int there = all.inverse_transition && all.noise_root && all.inverse_roots && all.rests &&
                all.back && all.spread;
    if (!complete(&reader, there)) {
        free(work);
        release(&reader);
        return NULL;
    }
    Py_BEGIN_ALLOW_THREADS
    turn_back_all(&all, work);
    Py_END_ALLOW_THREADS
    free(work);
    release(&reader);
    Py_RETURN_NONE;
}
