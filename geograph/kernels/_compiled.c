/*
The hot loops in C: the same equations as the NumPy code they stand in for, one measurement or one
interval at a time. geograph/kernels/__init__.py names them, and says which Python code is the
reference; tests/test_kernels.py holds both together.

Arrays come through the buffer protocol, C-contiguous, float64 or int64; their sizes are checked
here, their meaning in Python. Only the limited API is used: one build serves every Python from
3.11 on.
*/
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030b0000
#include <Python.h>

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* The same source for processors with wide registers and for those without, told apart by what they
   can do and not by who made them (arch=haswell would be Intel's alone). */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__linux__)
#if __GNUC__ >= 12
#define WIDE __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define WIDE __attribute__((target_clones("avx2", "default")))
#endif
#else
#define WIDE
#endif

#if defined(__GNUC__) || defined(__clang__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

typedef Py_ssize_t Size;

/* ---------------------------------------------------------------------------------- arrays */

typedef struct {
    Py_buffer view;
    int held;
} Array;

#define MOST_ARRAYS 64
#define MOST_ORDER 3

typedef struct {
    PyObject *const *arguments;
    Size given, next;
    Array held[MOST_ARRAYS];
    int count;
    int failed;
} Reader;

static void start(Reader *reader, PyObject *const *arguments, Size given)
{
    reader->arguments = arguments;
    reader->given = given;
    reader->next = 0;
    reader->count = 0;
    reader->failed = 0;
}

static void release(Reader *reader)
{
    for (int i = 0; i < reader->count; i++)
        PyBuffer_Release(&reader->held[i].view);
    reader->count = 0;
}

static PyObject *following(Reader *reader)
{
    if (reader->failed)
        return NULL;
    if (reader->next >= reader->given) {
        PyErr_SetString(PyExc_TypeError, "too few arguments");
        reader->failed = 1;
        return NULL;
    }
    return reader->arguments[reader->next++];
}

static Size whole(Reader *reader)
{
    PyObject *object = following(reader);
    if (object == NULL)
        return 0;
    Size value = PyLong_AsSsize_t(object);
    if (value < 0) {
        if (!PyErr_Occurred())
            PyErr_SetString(PyExc_ValueError, "expected a count of at least 0");
        reader->failed = 1;
        return 0;
    }
    return value;
}

static double number(Reader *reader)
{
    PyObject *object = following(reader);
    if (object == NULL)
        return 0.0;
    double value = PyFloat_AsDouble(object);
    if (value == -1.0 && PyErr_Occurred())
        reader->failed = 1;
    return value;
}

/* Return an array's data; NULL for None, or with reader->failed set. */
static void *array(Reader *reader, Size count, const char *formats, int writable)
{
    Size place = reader->next;
    PyObject *object = following(reader);
    if (object == NULL || object == Py_None)
        return NULL;
    int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (writable ? PyBUF_WRITABLE : 0);
    Array *own = &reader->held[reader->count];
    if (reader->count >= MOST_ARRAYS || PyObject_GetBuffer(object, &own->view, flags) < 0) {
        if (!PyErr_Occurred())
            PyErr_SetString(PyExc_TypeError, "too many arrays");
        reader->failed = 1;
        return NULL;
    }
    reader->count++;
    const char *format = own->view.format;
    int fits = format != NULL && strlen(format) == 1 && strchr(formats, format[0]) != NULL &&
               own->view.itemsize == 8 && own->view.len == 8 * count;
    if (!fits) {
        PyErr_Format(PyExc_ValueError,
                     "argument %zd holds %zd bytes of format %s; expected %zd of 8 bytes in %s",
                     place, own->view.len, format == NULL ? "none" : format, count, formats);
        reader->failed = 1;
        return NULL;
    }
    return own->view.buf;
}

static const double *reals(Reader *reader, Size count)
{
    return array(reader, count, "d", 0);
}

static double *results(Reader *reader, Size count)
{
    return array(reader, count, "d", 1);
}

static const int64_t *integers(Reader *reader, Size count)
{
    return array(reader, count, "lq", 0);
}

static int64_t *whole_results(Reader *reader, Size count)
{
    return array(reader, count, "lq", 1);
}

/* None was given where an array is needed. */
static int complete(Reader *reader, int all)
{
    if (!reader->failed && reader->next != reader->given) {
        PyErr_SetString(PyExc_TypeError, "too many arguments");
        reader->failed = 1;
    }
    if (!reader->failed && !all) {
        PyErr_SetString(PyExc_TypeError, "an array is missing");
        reader->failed = 1;
    }
    return !reader->failed;
}

/* ---------------------------------------------------------------------------------- matrices */

/* Four numbers at once, from any address; where the compiler has no such type, one by one. */
#if defined(__GNUC__) || defined(__clang__)
typedef double Four __attribute__((vector_size(32), aligned(8), may_alias));
#define FOUR(address) (*(const Four *)(address))
#define PUT_FOUR(address, value) (*(Four *)(address) = (value))
#endif
#define PADDED(size) (((size) + 3) & ~(Size)3)

/* Four rows of A'B from "total", or added to it: total += sign A'B with d rows of A and B, which are
   p and q apart; "width" columns of B, four or eight. */
INLINE void add_block(Size d, Size width, double sign, const double *one, Size p, const double *two,
                      Size q, double *total, Size t)
{
#ifdef FOUR
    Size parts = width / 4;
    Four sum[4][2];
    for (Size a = 0; a < 4; a++)
        for (Size b = 0; b < parts; b++)
            sum[a][b] = FOUR(total + a * t + 4 * b);
    for (Size k = 0; k < d; k++) {
        Four by[2];
        for (Size b = 0; b < parts; b++)
            by[b] = FOUR(two + k * q + 4 * b);
        for (Size a = 0; a < 4; a++) {
            double each = sign * one[k * p + a];
            for (Size b = 0; b < parts; b++)
                sum[a][b] += each * by[b];
        }
    }
    for (Size a = 0; a < 4; a++)
        for (Size b = 0; b < parts; b++)
            PUT_FOUR(total + a * t + 4 * b, sum[a][b]);
#else
    for (Size a = 0; a < 4; a++)
        for (Size b = 0; b < width; b++) {
            double sum = 0.0;
            for (Size k = 0; k < d; k++)
                sum += one[k * p + a] * two[k * q + b];
            total[a * t + b] += sign * sum;
        }
#endif
}

/* out (m x n) += A'B with k rows of A and B, p and q apart; m and n multiples of four, and none of the
   rows of A and B beyond them. */
INLINE void add_products(Size k, Size m, Size n, const double *a, Size p, const double *b, Size q,
                         double *out, Size t)
{
    for (Size i = 0; i < m; i += 4) {
        Size j = 0;
        for (; j + 8 <= n; j += 8)
            add_block(k, 8, 1.0, a + i, p, b + j, q, out + i * t + j, t);
        if (j < n)
            add_block(k, 4, 1.0, a + i, p, b + j, q, out + i * t + j, t);
    }
}

/* total -= R'R in the upper triangle (and a little below it), R (d x p), p a multiple of four. */
INLINE void take_square(Size d, Size p, const double *rows, double *total)
{
    for (Size i = 0; i < p; i += 4) {
        Size j = i;
        for (; j + 8 <= p; j += 8)
            add_block(d, 8, -1.0, rows + i, p, rows + j, p, total + i * p + j, p);
        if (j < p)
            add_block(d, 4, -1.0, rows + i, p, rows + j, p, total + i * p + j, p);
    }
}

/* row += by other, n a multiple of four. */
INLINE void add_row(Size n, double by, const double *other, double *row)
{
#ifdef FOUR
    for (Size c = 0; c < n; c += 4)
        PUT_FOUR(row + c, FOUR(row + c) + by * FOUR(other + c));
#else
    for (Size c = 0; c < n; c++)
        row[c] += by * other[c];
#endif
}

/* The inverse of the lower Cholesky factor of a symmetric matrix, of which the upper triangle is
   read and overwritten; rows are p apart, p a multiple of four, zero beyond d. 0 if it has none. */
INLINE int inverse_root(Size d, Size p, double *matrix, double *inverse)
{
    memset(inverse, 0, sizeof(double) * (size_t)(d * p));
    for (Size j = 0; j < d; j++) {
        double pivot = matrix[j * p + j];
        if (!(pivot > 0.0))
            return 0;
        double each = 1.0 / sqrt(pivot), *row = matrix + j * p, *own = inverse + j * p;
        Size from = j & ~(Size)3;
        for (Size c = from; c < p; c++)
            row[c] *= each;
        for (Size i = j + 1; i < d; i++) {
            Size begin = i & ~(Size)3;
            add_row(p - begin, -row[i], row + begin, matrix + i * p + begin);
        }
        /* Of the rows before, as row j of L X = I has it. */
        own[j] = 1.0;
        for (Size k = 0; k < j; k++)
            add_row(PADDED(k + 1), -matrix[k * p + j], inverse + k * p, own);
        for (Size c = 0; c < PADDED(j + 1); c++)
            own[c] *= each;
    }
    return 1;
}

/* ---------------------------------------------------------------------------------- sweep */

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

/* ---------------------------------------------------------------------------------- blocks */

typedef struct {
    Size n, r, intervals, held, path, walks, constants, order, e, f;
    int chained;
    double *knots, *others;
    const double *residual, *by_path, *weights, *scale, *by_constants, *before, *after, *by_walks;
    const double *weight;
    const int64_t *interval, *constant_row, *constant_column, *walk_row, *walk_column;
    const Size *first, *entry, *first_walk, *entry_walk;
} Blocks;

/* What the measurements of one interval add up to before it is written to the result: products of
   the knots' columns, or moments of which these are made, and of these columns with the others'. */
typedef struct {
    double *own, *cross, *row;
    double *pairs, *moments; /* of measurements that are not in own yet */
    Size waiting;
    char *touched;
    Size *from, *at; /* of the columns that were touched: their place in cross, and in the result */
} Held;

/* Index the entries of each row: those of row i are order[first[i]] to order[first[i + 1] - 1]. */
static int by_row(Size n, Size e, const int64_t *row, Size *first, Size *order)
{
    int sorted = e == 0 || (row[0] >= 0 && row[e - 1] < n);
    for (Size k = 1; k < e; k++)
        sorted &= row[k - 1] <= row[k];
    if (sorted) {
        Size i = 0;
        for (Size k = 0; k < e; k++) {
            while (i <= row[k])
                first[i++] = k;
            order[k] = k;
        }
        while (i < n + 2)
            first[i++] = e;
        return 1;
    }
    memset(first, 0, sizeof(Size) * (size_t)(n + 2));
    for (Size k = 0; k < e; k++) {
        if (row[k] < 0 || row[k] >= n)
            return 0;
        first[row[k] + 2]++;
    }
    for (Size i = 2; i < n + 2; i++)
        first[i] += first[i - 1];
    for (Size k = 0; k < e; k++)
        order[first[row[k] + 1]++] = k;
    return 1;
}

/* Lay out one row of a measurement over the columns of its knots. */
INLINE void lay_out(const Blocks *all, Size i, Size q, double root, Size d, Size knots,
                           double *row)
{
    const double *by = all->by_path + (i * all->r + q) * 2 * all->path;
    if (all->walks)
        memset(row, 0, sizeof(double) * (size_t)knots);
    for (Size half = 0; half * d < knots; half++)
        for (Size j = 0; j < all->path; j++)
            row[half * d + j] = root * by[half * all->path + j] * all->scale[j];
    for (Size k = all->first_walk[i]; k < all->first_walk[i + 1]; k++) {
        Size entry = all->entry_walk[k];
        Size column = all->path + (Size)all->walk_column[entry];
        double value = root * all->by_walks[entry * all->r + q];
        row[column] += value * all->before[entry];
        row[column + d] += value * all->after[entry];
    }
}

/* The product of the few numbers of one measurement. */
INLINE double few(Size r, const double *a, const double *b)
{
    double value = 0.0;
    for (Size q = 0; q < r; q++)
        value += a[q] * b[q];
    return value;
}

/* Add the products of a measurement's residual and its derivatives by the constants. */
INLINE void add_others(Size r, const Blocks *all, Size i, double root, double *others)
{
    Size last = all->constants, c = last + 1;
    const double *residual = all->residual + i * r;
    double square = root * root;
    for (Size k = all->first[i]; k < all->first[i + 1]; k++) {
        const double *by = all->by_constants + all->entry[k] * r;
        Size column = (Size)all->constant_column[all->entry[k]];
        double *out = others + column * c;
        for (Size m = all->first[i]; m < k; m++) {
            double product = square * few(r, by, all->by_constants + all->entry[m] * r);
            Size beside = (Size)all->constant_column[all->entry[m]];
            if (beside < column)
                out[beside] += product;
            else if (beside > column)
                others[beside * c + column] += product;
            else
                /* Two entries in one place: each meets the other. */
                out[column] += 2.0 * product;
        }
        out[column] += square * few(r, by, by);
        others[last * c + column] += square * few(r, by, residual);
    }
    others[last * c + last] += square * few(r, residual, residual);
}

/* Add a measurement's rows to the sums of its interval, two at a time. */
INLINE void add_rows_of(const Blocks *all, Size i, double root, Size d, Size knots,
                               Held *held)
{
    Size r = all->r;
    double *row = held->row, *restrict other = row + knots;
    for (Size q = 0; q < r; q += 2) {
        int pair = q + 1 < r;
        lay_out(all, i, q, root, d, knots, row);
        if (pair)
            lay_out(all, i, q + 1, root, d, knots, other);
        else
            memset(other, 0, sizeof(double) * (size_t)knots);
        for (Size a = 0; a < knots; a++) {
            double one = row[a], two = other[a];
            double *restrict out = held->own + a * knots;
            /* A few columns beyond the diagonal, so that whole registers are filled. */
            Size end = (a + 4) & ~(Size)3;
            if (end > knots)
                end = knots;
            for (Size b = 0; b < end; b++)
                out[b] += one * row[b] + two * other[b];
        }
        for (Size k = all->first[i]; k <= all->first[i + 1]; k++) {
            int residual = k == all->first[i + 1];
            const double *by = residual ? all->residual + i * r + q
                                        : all->by_constants + all->entry[k] * r + q;
            Size column = residual ? all->constants : (Size)all->constant_column[all->entry[k]];
            double one = root * by[0], two = pair ? root * by[1] : 0.0;
            double *restrict out = held->cross + column * knots;
            held->touched[column] = 1;
            for (Size b = 0; b < knots; b++)
                out[b] += one * row[b] + two * other[b];
        }
    }
}

/* Pairs of blocks, later times earlier, in the order of their moments; padded to whole registers. */
#define MOST_PAIRS 24

/* Six moments, padded; measurements whose moments wait to be multiplied by their pairs at once. */
#define MOMENTS 8
#define WAITING 16

INLINE void add_waiting(Size size, Held *held)
{
    Size pairs = PADDED(size * (size + 1) / 2);
    for (Size m = 0; m < MOMENTS; m += 4) {
        Size b = 0;
        double *out = held->own + m * MOST_PAIRS;
        for (; b + 8 <= pairs; b += 8)
            add_block(held->waiting, 8, 1.0, held->moments + m, MOMENTS, held->pairs + b, MOST_PAIRS,
                      out + b, MOST_PAIRS);
        if (b < pairs)
            add_block(held->waiting, 4, 1.0, held->moments + m, MOMENTS, held->pairs + b, MOST_PAIRS,
                      out + b, MOST_PAIRS);
    }
    held->waiting = 0;
}

/* The same where the rows are weights of the blocks times a derivative by the position: six moments
   of each pair of blocks, of which the products are made once an interval. Columns are those of
   one axis after another, each axis padded to whole registers. */
INLINE void add_moments_of(Size size, Size r, const Blocks *all, Size i, double root, Size knots,
                           Held *held, double *total)
{
    Size d = knots / 2, width = knots + all->constants + 1, pitch = PADDED(size);
    const double *by = all->by_path + i * r * 3;
    double w[PADDED(2 * MOST_ORDER)] = {0.0};
    for (Size b = 0; b < size; b++)
        w[b] = all->weights[i * size + b];
    double square = root * root, *moment = held->moments + held->waiting * MOMENTS;
    double *pair = held->pairs + held->waiting * MOST_PAIRS;
    memset(moment, 0, sizeof(double) * MOMENTS);
    for (Size q = 0; q < r; q++) {
        const double *j = by + 3 * q;
        moment[0] += j[0] * j[0];
        moment[1] += j[1] * j[0];
        moment[2] += j[1] * j[1];
        moment[3] += j[2] * j[0];
        moment[4] += j[2] * j[1];
        moment[5] += j[2] * j[2];
    }
    Size p = 0;
    for (Size a = 0; a < size; a++)
        for (Size b = 0; b <= a; b++)
            pair[p++] = square * w[a] * w[b];
    if (++held->waiting == WAITING)
        add_waiting(size, held);
    for (Size k = all->first[i]; k <= all->first[i + 1]; k++) {
        int residual = k == all->first[i + 1];
        const double *other = residual ? all->residual + i * r
                                       : all->by_constants + all->entry[k] * r;
        Size column = residual ? all->constants : (Size)all->constant_column[all->entry[k]];
        double along[3] = {0.0, 0.0, 0.0};
        for (Size q = 0; q < r; q++)
            for (Size j = 0; j < 3; j++)
                along[j] += by[3 * q + j] * other[q];
        held->touched[column] = 1;
        double *restrict out = held->cross + column * 3 * pitch;
        for (Size j = 0; j < 3; j++)
            add_row(pitch, square * along[j], w, out + j * pitch);
    }
    /* Walks have two columns each, at the knot before and at the one after. */
    for (Size k = all->first_walk[i]; k < all->first_walk[i + 1]; k++) {
        Size entry = all->entry_walk[k], walk = (Size)all->walk_column[entry];
        const double *own = all->by_walks + entry * r;
        double along[3] = {0.0, 0.0, 0.0};
        for (Size q = 0; q < r; q++)
            for (Size j = 0; j < 3; j++)
                along[j] += by[3 * q + j] * own[q];
        for (Size half = 0; half < 2; half++) {
            double share = square * (half ? all->after[entry] : all->before[entry]);
            Size column = all->constants + 1 + half * all->walks + walk;
            double *restrict out = held->cross + column * 3 * pitch;
            held->touched[column] = 1;
            for (Size j = 0; j < 3; j++)
                add_row(pitch, share * along[j], w, out + j * pitch);
            double *row = total + (half * d + all->path + walk) * width;
            for (Size m = all->first_walk[i]; m < all->first_walk[i + 1]; m++) {
                Size other = all->entry_walk[m], beside = all->path + (Size)all->walk_column[other];
                double product = 0.0;
                for (Size q = 0; q < r; q++)
                    product += own[q] * all->by_walks[other * r + q];
                row[beside] += share * product * all->before[other];
                row[beside + d] += share * product * all->after[other];
            }
            for (Size m = all->first[i]; m <= all->first[i + 1]; m++) {
                int residual = m == all->first[i + 1];
                const double *other = residual ? all->residual + i * r
                                               : all->by_constants + all->entry[m] * r;
                double product = 0.0;
                for (Size q = 0; q < r; q++)
                    product += own[q] * other[q];
                row[knots + (residual ? all->constants
                                      : (Size)all->constant_column[all->entry[m]])] +=
                    share * product;
            }
        }
    }
}

/* Write what was held of an interval, and hold nothing. */
INLINE void put_rows(const Blocks *all, Size place, Size knots, Held *held)
{
    Size others = all->constants + 1, width = knots + others;
    double *total = all->knots + place * knots * width;
    for (Size a = 0; a < knots; a++) {
        for (Size b = 0; b < a; b++) {
            total[a * width + b] += held->own[a * knots + b];
            total[b * width + a] += held->own[a * knots + b];
        }
        total[a * width + a] += held->own[a * knots + a];
    }
    memset(held->own, 0, sizeof(double) * (size_t)(knots * knots));
    for (Size column = 0; column < others; column++) {
        if (!held->touched[column])
            continue;
        double *cross = held->cross + column * knots;
        for (Size a = 0; a < knots; a++)
            total[a * width + knots + column] += cross[a];
        memset(cross, 0, sizeof(double) * (size_t)knots);
        held->touched[column] = 0;
    }
}

/* The same of moments: block b of a knot's state is of its half and component, on each axis. */
INLINE void put_moments(Size order, const Blocks *all, Size place, Size knots, Held *held)
{
    Size others = all->constants + 1, width = knots + others, size = 2 * order, d = knots / 2;
    Size pitch = PADDED(size), length = 3 * pitch, count = 0, columns = others + 2 * all->walks;
    double *total = all->knots + place * knots * width;
    add_waiting(size, held);
    for (Size a = 0; a < size; a++)
        for (Size b = 0; b < size; b++) {
            const double *own = held->own + (a >= b ? a * (a + 1) / 2 + b : b * (b + 1) / 2 + a);
            const double *one = all->scale + 3 * (a % order), *two = all->scale + 3 * (b % order);
            double *to = total + (a / order * d + 3 * (a % order)) * width + b / order * d +
                         3 * (b % order);
            for (Size j = 0; j < 3; j++)
                for (Size m = 0; m < 3; m++)
                    to[j * width + m] +=
                        one[j] * two[m] *
                        own[(j >= m ? j * (j + 1) / 2 + m : m * (m + 1) / 2 + j) * MOST_PAIRS];
        }
    memset(held->own, 0, sizeof(double) * MOMENTS * MOST_PAIRS);
    for (Size column = 0; column < columns; column++)
        if (held->touched[column]) {
            Size walk = column - others;
            held->from[count] = column * length;
            held->at[count++] = walk < 0            ? knots + column
                                : walk < all->walks ? all->path + walk
                                                    : d + all->path + walk - all->walks;
            held->touched[column] = 0;
        }
    for (Size j = 0; j < 3; j++)
        for (Size b = 0; b < size; b++) {
            Size row = b / order * d + 3 * (b % order) + j;
            double scale = all->scale[3 * (b % order) + j], *to = total + row * width;
            const double *cross = held->cross + j * pitch + b;
            for (Size k = 0; k < count; k++) {
                double value = scale * cross[held->from[k]];
                to[held->at[k]] += value;
                if (held->at[k] < knots)
                    total[held->at[k] * width + row] += value;
            }
        }
    if (4 * count > columns)
        memset(held->cross, 0, sizeof(double) * (size_t)(columns * length));
    else
        for (Size k = 0; k < count; k++)
            memset(held->cross + held->from[k], 0, sizeof(double) * (size_t)length);
}

INLINE void put(Size order, const Blocks *all, Size place, Size knots, Held *held)
{
    if (order)
        put_moments(order, all, place, knots, held);
    else
        put_rows(all, place, knots, held);
}

INLINE int add_all_of(Size order, Size r, const Blocks *all, Held *held)
{
    Size d = all->path + all->walks, knots = all->chained ? 2 * d : d;
    Size c = all->constants + 1, before = -1;
    for (Size i = 0; i < all->n; i++) {
        Size place = (Size)all->interval[i];
        if (place != before && before >= 0)
            put(order, all, before, knots, held);
        before = place;
        double root = all->weight == NULL ? 1.0 : all->weight[i];
        if (order)
            add_moments_of(2 * order, r, all, i, root, knots, held,
                           all->knots + place * knots * (knots + c));
        else
            add_rows_of(all, i, root, d, knots, held);
        add_others(r, all, i, root, all->others + (all->held > 1 ? place * c * c : 0));
    }
    if (before >= 0)
        put(order, all, before, knots, held);
    for (Size k = 0; k < all->held; k++)
        mirror(c, all->others + k * c * c);
    return 1;
}

WIDE static int add_all(const Blocks *all, Held *held)
{
    if (all->order == 0)
        return add_all_of(0, all->r, all, held);
    /* Loops of known length are unrolled for the usual motions and rows. */
    if (all->order == 3 && all->r == 2)
        return add_all_of(3, 2, all, held);
    if (all->order == 2 && all->r == 2)
        return add_all_of(2, 2, all, held);
    return add_all_of(all->order, all->r, all, held);
}

/* Make room for the sums of an interval; NULL without memory. */
static double *make_room(const Blocks *all, Size knots, Held *held)
{
    Size columns = all->constants + 1 + 2 * all->walks, size = 2 * all->order;
    Size own = all->order ? MOMENTS * MOST_PAIRS : knots * knots;
    Size waiting = all->order ? WAITING * (MOST_PAIRS + MOMENTS) : 0;
    Size length = all->order ? 3 * PADDED(size) : knots;
    Size held_apart = own + columns * length + 2 * knots;
    double *room = calloc((size_t)(held_apart + waiting + 1), sizeof(double));
    if (room == NULL)
        return NULL;
    held->waiting = 0;
    held->pairs = room + held_apart;
    held->moments = held->pairs + WAITING * MOST_PAIRS;
    held->own = room;
    held->cross = held->own + own;
    held->row = held->cross + columns * length;
    return room;
}

static PyObject *add_blocks(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    Blocks all;
    start(&reader, arguments, given);
    all.intervals = whole(&reader);
    all.held = whole(&reader);
    all.path = whole(&reader);
    all.walks = whole(&reader);
    all.constants = whole(&reader);
    all.chained = (int)whole(&reader);
    all.n = whole(&reader);
    all.r = whole(&reader);
    all.order = whole(&reader);
    all.e = whole(&reader);
    all.f = whole(&reader);
    if (!reader.failed &&
        ((all.held != 1 && all.held != all.intervals) ||
         (all.order &&
          (!all.chained || all.path != 3 * all.order || all.order > MOST_ORDER)))) {
        PyErr_SetString(PyExc_ValueError, "expected sums of one interval or of each; weights of "
                                          "blocks only along a chain of 1 to 3 blocks");
        reader.failed = 1;
    }
    Size d = all.path + all.walks, knots = all.chained ? 2 * d : d;
    Size columns = all.constants + 1;
    all.knots = results(&reader, all.intervals * knots * (knots + columns));
    all.others = results(&reader, all.held * columns * columns);
    all.residual = reals(&reader, all.n * all.r);
    all.interval = integers(&reader, all.n);
    all.by_path = reals(&reader, all.n * all.r * (all.order ? 3 : 2 * all.path));
    all.weights = reals(&reader, all.n * 2 * all.order);
    all.scale = reals(&reader, all.path);
    all.constant_row = integers(&reader, all.e);
    all.constant_column = integers(&reader, all.e);
    all.by_constants = reals(&reader, all.e * all.r);
    all.walk_row = integers(&reader, all.f);
    all.walk_column = integers(&reader, all.f);
    all.before = reals(&reader, all.f);
    all.after = reals(&reader, all.f);
    all.by_walks = reals(&reader, all.f * all.r);
    all.weight = reals(&reader, all.n);
    int there = all.knots && all.others && all.residual && all.interval && all.by_path &&
                all.scale && all.constant_row && all.constant_column && all.by_constants &&
                all.walk_row && all.walk_column && all.before && all.after && all.by_walks &&
                (all.weights || !all.order);
    if (!complete(&reader, there)) {
        release(&reader);
        return NULL;
    }
    int fits = all.f == 0 || all.chained;
    for (Size k = 0; k < all.n; k++)
        fits &= all.interval[k] >= 0 && all.interval[k] < all.intervals;
    for (Size k = 0; k < all.e; k++)
        fits &= all.constant_column[k] >= 0 && all.constant_column[k] < all.constants;
    for (Size k = 0; k < all.f; k++)
        fits &= all.walk_column[k] >= 0 && all.walk_column[k] < all.walks;
    Size touched = columns + 2 * all.walks, entries = 2 * (all.n + 2) + all.e + all.f;
    Size *index = malloc(sizeof(Size) * (size_t)(entries + 2 * touched));
    Held held;
    double *room = make_room(&all, knots, &held);
    held.touched = calloc((size_t)touched, 1);
    if (index == NULL || room == NULL || held.touched == NULL) {
        free(index);
        free(room);
        free(held.touched);
        release(&reader);
        return PyErr_NoMemory();
    }
    Py_BEGIN_ALLOW_THREADS
    held.from = index + entries;
    held.at = held.from + touched;
    Size *first = index, *first_walk = first + all.n + 2;
    Size *entry = first_walk + all.n + 2, *entry_walk = entry + all.e;
    all.first = first;
    all.first_walk = first_walk;
    all.entry = entry;
    all.entry_walk = entry_walk;
    fits = fits && by_row(all.n, all.e, all.constant_row, first, entry) &&
           by_row(all.n, all.f, all.walk_row, first_walk, entry_walk) && add_all(&all, &held);
    Py_END_ALLOW_THREADS
    free(index);
    free(room);
    free(held.touched);
    release(&reader);
    if (!fits) {
        PyErr_SetString(PyExc_IndexError, "an interval, row or column is out of range");
        return NULL;
    }
    Py_RETURN_NONE;
}

/* ---------------------------------------------------------------------------------- bearings */

/* Channels of error, as geograph.states has them; the module exports them to be checked. */
enum { AZIMUTH = 0, ELEVATION = 1, CLOCK = 2, POSITION = 3, VELOCITY = 6, SPEED = 10, CHANNELS = 14 };

typedef struct {
    Size n, knots, order, e, s, f, walks, poses;
    const double *knots_s, *basis, *hermite;
    const int64_t *pose; /* of each bearing: the row of the four that follow */
    const double *sensor_m, *axes, *sensor_velocity, *axes_rate, *received_s;
    const double *azimuth, *elevation, *turned, *tangent, *white;
    double speed_m_s, spin_rad_s, enough_s;
    int clocked, fast, noisy, rounds;
    double *light_time_s, *residual, *time_s, *weights, *by_position, *by_constants;
    int64_t *interval;
    const int64_t *constant_row, *constant_channel, *constant_column;
    const double *constant_basis, *constants;
    const int64_t *walk_row, *walk_channel, *walk_column;
    const double *walk_basis, *walk_time, *chains;
    double *walk_before, *walk_after, *by_walks;
    const Size *first, *entry, *first_walk, *entry_walk;
} Bearings;

INLINE double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static const double FACTORIAL[2 * MOST_ORDER] = {1.0, 1.0, 2.0, 6.0, 24.0, 120.0};

/* factors/kinematics.py: interpolation_weights, of position and velocity; without the latter where
   it is not asked for. */
INLINE void weights(Size order, int moving, const double *hermite, double step, double offset,
                    double *position, double *velocity)
{
    Size size = 2 * order;
    double each = 1.0 / step, s = offset * each;
    if (s < 0.0 || s > 1.0) {
        Size first = s < 0.0 ? 0 : order;
        double since = s < 0.0 ? offset : offset - step, power = 1.0;
        memset(position, 0, sizeof(double) * (size_t)size);
        memset(velocity, 0, sizeof(double) * (size_t)size);
        for (Size block = 0; block < order; block++) {
            position[first + block] = power / FACTORIAL[block];
            if (block + 1 < order)
                velocity[first + block + 1] = power / FACTORIAL[block];
            power *= since;
        }
        return;
    }
    double powers[2 * MOST_ORDER], unit = 1.0;
    powers[0] = 1.0;
    for (Size power = 1; power < size; power++)
        powers[power] = powers[power - 1] * s;
    for (Size block = 0; block < order; block++, unit *= step)
        for (Size knot = 0; knot < 2; knot++) {
            Size row = knot * order + block;
            const double *by = hermite + row * size;
            double value = by[0], slope = 0.0;
            for (Size power = 1; power < size; power++) {
                value += by[power] * powers[power];
                if (moving)
                    slope += by[power] * (double)power * powers[power - 1];
            }
            position[row] = value * unit;
            if (moving)
                velocity[row] = slope * unit * each;
        }
}

/* The interval that a time lies in, clipped to the first and the last; searched from a guess. */
static inline Size find(const double *knots_s, Size knots, double time, Size guess)
{
    Size last = knots - 2;
    if (guess > last)
        guess = last;
    if (time >= knots_s[guess] || guess == 0) {
        if (guess == last || time < knots_s[guess + 1])
            return guess;
    }
    Size low = 0, high = knots; /* the first knot after the time is in (low, high] */
    while (low < high) {
        Size middle = (low + high) / 2;
        if (knots_s[middle] <= time)
            low = middle + 1;
        else
            high = middle;
    }
    Size found = low - 1;
    return found < 0 ? 0 : found > last ? last : found;
}

typedef struct {
    double line[3], distance, light_time, velocity[3], inertial[3];
} Sight;

/* factors/light_time.py: sight. */
INLINE Sight look(const double *at, const double *velocity, const double *sensor,
                         double light_time, double spin)
{
    Sight found;
    double turned[3] = {at[0], at[1], at[2]};
    memcpy(found.velocity, velocity, sizeof found.velocity);
    if (spin != 0.0) {
        double sine = sin(spin * light_time), cosine = cos(spin * light_time);
        turned[0] = cosine * at[0] + sine * at[1];
        turned[1] = cosine * at[1] - sine * at[0];
        found.velocity[0] = cosine * velocity[0] + sine * velocity[1];
        found.velocity[1] = cosine * velocity[1] - sine * velocity[0];
    }
    memcpy(found.inertial, found.velocity, sizeof found.inertial);
    if (spin != 0.0) {
        found.inertial[0] -= spin * turned[1];
        found.inertial[1] += spin * turned[0];
    }
    for (int i = 0; i < 3; i++)
        found.line[i] = turned[i] - sensor[i];
    found.distance = sqrt(dot(found.line, found.line));
    found.light_time = light_time;
    return found;
}

/* Residual of a bearing with its derivatives by the line of sight in the sensor's axes, and by the
   errors of azimuth and elevation. */
typedef struct {
    double value[2], by_sight[2][3], by_error[2][2];
} Miss;

#define ZENITH_ROUNDING 0.02
#define OPPOSITE 1e-7
#define LEAST_COSINE 1e-7

/* Cosine and sine of an angle less "by", from those of the angle. */
INLINE void turn_by(const double *angle, double by, double *cosine, double *sine)
{
    double c, s;
    if (fabs(by) < 0.05) {
        double square = by * by;
        c = 1.0 - square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0)));
        s = by * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0)));
    } else {
        c = cos(by);
        s = sin(by);
    }
    *cosine = angle[0] * c + angle[1] * s;
    *sine = angle[1] * c - angle[0] * s;
}

/* factors/bearing.py: tangent_residual; "measured" has cosine and sine of azimuth and of elevation,
   from which the errors are taken. "noisy": the noise's metric is that of the measured elevation. */
INLINE Miss tangent_miss(const double *sight, const double *measured, const double *errors, int noisy)
{
    Miss found;
    double sin_a, cos_a, sin_e, cos_e;
    turn_by(measured, errors[AZIMUTH], &cos_a, &sin_a);
    turn_by(measured + 2, errors[ELEVATION], &cos_e, &sin_e);
    double near = 1.0 / sqrt(dot(sight, sight));
    double direction[3] = {sight[0] * near, sight[1] * near, sight[2] * near};
    double forward = direction[0] * cos_a + direction[1] * sin_a, up = direction[2];
    double s1 = direction[1] * cos_a - direction[0] * sin_a;
    double s2 = up * cos_e - forward * sin_e;
    double c = forward * cos_e + up * sin_e;
    double sine2 = s1 * s1 + s2 * s2;
    if (sine2 < OPPOSITE * OPPOSITE && c < 0.0) {
        s1 = OPPOSITE;
        s2 = 0.0;
        sine2 = s1 * s1 + s2 * s2;
    }
    double stretch = 1.0 + sine2 * (1.0 / 6.0 + sine2 * (3.0 / 40.0));
    double curvature = 1.0 / 3.0 + sine2 * (2.0 / 15.0);
    if (sine2 > 1e-6 || c < 0.0) {
        double sine = sqrt(sine2), theta = atan2(sine, c);
        stretch = theta / sine;
        curvature = (sine - theta * c) / (sine * sine * sine);
    }
    double ratio = 1.0, level2 = 1.0;
    if (noisy) {
        double noise = measured[2];
        level2 = cos_e * cos_e + ZENITH_ROUNDING * ZENITH_ROUNDING;
        ratio = sqrt((noise * noise + ZENITH_ROUNDING * ZENITH_ROUNDING) / level2);
    }
    found.value[0] = stretch * s1;
    found.value[1] = stretch * s2;
    double e1[3] = {-sin_a, cos_a, 0.0};
    double e2[3] = {-sin_e * cos_a, -sin_e * sin_a, cos_e};
    double u[3] = {cos_e * cos_a, cos_e * sin_a, sin_e};
    /* dr = stretch ds + curvature s (c s.ds - sin^2 dc). */
    for (int axis = 0; axis < 3; axis++) {
        double by = direction[axis];
        double ds1 = e1[axis] - s1 * by, ds2 = e2[axis] - s2 * by, dc = u[axis] - c * by;
        double both = curvature * (c * (s1 * ds1 + s2 * ds2) - sine2 * dc);
        found.by_sight[0][axis] = (stretch * ds1 + s1 * both) * near;
        found.by_sight[1][axis] = (stretch * ds2 + s2 * both) * near;
    }
    double turned[2][3] = {{sin_e * s2 - cos_e * c, -sin_e * s1, cos_e * s1}, {0.0, -c, s2}};
    for (int error = 0; error < 2; error++) {
        double ds1 = turned[error][0], ds2 = turned[error][1], dc = turned[error][2];
        double both = curvature * (c * (s1 * ds1 + s2 * ds2) - sine2 * dc);
        found.by_error[0][error] = -(stretch * ds1 + s1 * both);
        found.by_error[1][error] = -(stretch * ds2 + s2 * both);
    }
    if (noisy) {
        found.by_error[0][1] -= found.value[0] * cos_e * sin_e / level2;
        found.value[0] *= ratio;
        for (int axis = 0; axis < 3; axis++)
            found.by_sight[0][axis] *= ratio;
        found.by_error[0][0] *= ratio;
        found.by_error[0][1] *= ratio;
    }
    return found;
}

/* factors/bearing.py: coordinate_residual. */
INLINE Miss coordinate_miss(const double *sight, double azimuth, double elevation)
{
    Miss found;
    memset(&found, 0, sizeof found);
    double a = sight[0], b = sight[1], c = sight[2];
    double horizontal = hypot(a, b), distance2 = dot(sight, sight);
    double safe = fmax(horizontal, LEAST_COSINE * sqrt(distance2));
    double square = safe * safe, tilt = c / (safe * distance2);
    const double pi = 3.14159265358979323846;
    double gap = atan2(b, a) - azimuth + pi;
    found.value[0] = gap - 2.0 * pi * floor(gap / (2.0 * pi)) - pi;
    found.by_sight[0][0] = -b / square;
    found.by_sight[0][1] = a / square;
    found.by_error[0][0] = 1.0;
    if (!isnan(elevation)) {
        found.value[1] = atan2(c, horizontal) - elevation;
        found.by_sight[1][0] = -a * tilt;
        found.by_sight[1][1] = -b * tilt;
        found.by_sight[1][2] = horizontal / distance2;
        found.by_error[1][1] = 1.0;
    }
    return found;
}

/* Derivatives of the whitened rows by all channels of error and by the position at emission;
   families/bearings.py: _derivatives. */
INLINE void derive(const Bearings *all, Size i, Size pose, const double *errors, const Sight *seen,
                   const Miss *miss, double speed, double by_channel[2][CHANNELS],
                   double by_position[2][3])
{
    const double *axes = all->axes + 9 * pose;
    double unit[3], rate = speed;
    for (int j = 0; j < 3; j++)
        unit[j] = seen->line[j] / seen->distance;
    rate += dot(unit, seen->inertial);
    double sine = 0.0, cosine = 1.0;
    if (all->spin_rad_s != 0.0) {
        sine = sin(all->spin_rad_s * seen->light_time);
        cosine = cos(all->spin_rad_s * seen->light_time);
    }
    for (int q = 0; q < 2; q++) {
        double white = all->white[2 * i + q], in_axes[3], by[3];
        memset(by_channel[q], 0, sizeof by_channel[q]);
        for (int j = 0; j < 3; j++)
            in_axes[j] = miss->by_sight[q][j] * white;
        for (int j = 0; j < 3; j++)
            by[j] = in_axes[0] * axes[j] + in_axes[1] * axes[3 + j] + in_axes[2] * axes[6 + j];
        if (isfinite(all->speed_m_s)) {
            double along = dot(by, seen->inertial);
            if (all->fast)
                /* A faster signal was emitted later. */
                by_channel[q][SPEED] = along * seen->distance / (rate * speed);
            for (int j = 0; j < 3; j++)
                by[j] -= along * unit[j] / rate;
        }
        by_channel[q][AZIMUTH] = miss->by_error[q][0] * white;
        by_channel[q][ELEVATION] = miss->by_error[q][1] * white;
        for (int j = 0; j < 3; j++)
            by_channel[q][POSITION + j] = -by[j];
        if (all->clocked) {
            double by_time = 0.0;
            for (int j = 0; j < 3; j++)
                by_time += by[j] * (seen->velocity[j] - all->sensor_velocity[3 * pose + j] -
                                    errors[VELOCITY + j]);
            if (all->axes_rate != NULL)
                for (int j = 0; j < 3; j++)
                    by_time += in_axes[j] * dot(all->axes_rate + 9 * pose + 3 * j, seen->line);
            by_channel[q][CLOCK] = -by_time;
        }
        by_position[q][0] = cosine * by[0] - sine * by[1];
        by_position[q][1] = sine * by[0] + cosine * by[1];
        by_position[q][2] = by[2];
    }
}

/* "moving": velocities matter, for signals take their time or clocks are off. */
INLINE void bearings_of(Size order, int moving, const Bearings *all)
{
    Size size = 2 * order, guess = 0;
    for (Size i = 0; i < all->n; i++) {
        double errors[CHANNELS] = {0.0};
        Size pose = (Size)all->pose[i];
        for (Size k = all->first[i]; k < all->first[i + 1]; k++) {
            Size entry = all->entry[k];
            errors[all->constant_channel[entry]] +=
                all->constant_basis[entry] * all->constants[all->constant_column[entry]];
        }
        double speed = all->speed_m_s + errors[SPEED], sensor[3], place[2 * MOST_ORDER], rates[2 * MOST_ORDER];
        for (int j = 0; j < 3; j++)
            sensor[j] = all->sensor_m[3 * pose + j] + errors[POSITION + j];
        double light_time = all->light_time_s[i], emitted = 0.0;
        Sight seen;
        memset(&seen, 0, sizeof seen);
        for (int round = 0; round < all->rounds; round++) {
            emitted = all->received_s[i] - light_time;
            guess = find(all->knots_s, all->knots, emitted, guess);
            double before = all->knots_s[guess];
            weights(order, moving, all->hermite, all->knots_s[guess + 1] - before,
                    emitted - before, place, rates);
            const double *basis = all->basis + guess * size * 3;
            double at[3] = {0.0, 0.0, 0.0}, velocity[3] = {0.0, 0.0, 0.0};
            for (Size b = 0; b < size; b++)
                for (int j = 0; j < 3; j++) {
                    at[j] += place[b] * basis[3 * b + j];
                    if (moving)
                        velocity[j] += rates[b] * basis[3 * b + j];
                }
            seen = look(at, velocity, sensor, light_time, all->spin_rad_s);
            if (!moving || isinf(all->speed_m_s))
                break;
            double closing = dot(seen.line, seen.inertial) / seen.distance;
            double correction = (seen.distance - speed * light_time) / (speed + closing);
            if (!(fabs(correction) > all->enough_s)) {
                /* What is left is below a microsecond: straight motion meets it. */
                for (int j = 0; j < 3; j++)
                    at[j] -= velocity[j] * correction;
                seen = look(at, velocity, sensor, light_time + correction, all->spin_rad_s);
                break;
            }
            light_time = fmax(light_time + correction, 0.0);
        }
        /* Walks are of the directions alone, and are read in the interval of the emission; beyond it
           a walk is what it was at the nearer knot. */
        for (Size k = all->first_walk[i]; k < all->first_walk[i + 1]; k++) {
            Size entry = all->entry_walk[k];
            const double *chain = all->chains + guess * all->walks + all->walk_column[entry];
            double after = (all->walk_time[i] - all->knots_s[guess]) /
                           (all->knots_s[guess + 1] - all->knots_s[guess]);
            after = after < 0.0 ? 0.0 : after > 1.0 ? 1.0 : after;
            all->walk_before[entry] = 1.0 - after;
            all->walk_after[entry] = after;
            errors[all->walk_channel[entry]] +=
                ((1.0 - after) * chain[0] + after * chain[all->walks]) * all->walk_basis[entry];
        }
        all->light_time_s[i] = light_time;
        all->interval[i] = guess;
        all->time_s[i] = emitted;
        const double *axes = all->axes + 9 * pose;
        double sight[3] = {dot(axes, seen.line), dot(axes + 3, seen.line), dot(axes + 6, seen.line)};
        Miss miss;
        if (all->tangent == NULL || all->tangent[i] != 0.0)
            miss = tangent_miss(sight, all->turned + 4 * i, errors, all->noisy);
        else
            miss = coordinate_miss(sight, all->azimuth[i] - errors[AZIMUTH],
                                   all->elevation[i] - errors[ELEVATION]);
        for (int q = 0; q < 2; q++)
            all->residual[2 * i + q] = miss.value[q] * all->white[2 * i + q];
        if (all->by_position == NULL)
            continue;
        double channel[2][CHANNELS];
        derive(all, i, pose, errors, &seen, &miss, speed, channel, (double(*)[3])(all->by_position + 6 * i));
        memcpy(all->weights + i * size, place, sizeof(double) * (size_t)size);
        for (Size k = all->first[i]; k < all->first[i + 1]; k++) {
            Size entry = all->entry[k], by = (Size)all->constant_channel[entry];
            for (int q = 0; q < 2; q++)
                all->by_constants[2 * entry + q] = channel[q][by] * all->constant_basis[entry];
        }
        for (Size k = all->first_walk[i]; k < all->first_walk[i + 1]; k++) {
            Size entry = all->entry_walk[k], by = (Size)all->walk_channel[entry];
            for (int q = 0; q < 2; q++)
                all->by_walks[2 * entry + q] = channel[q][by] * all->walk_basis[entry];
        }
    }
}

WIDE static void bearings_all(const Bearings *all)
{
    int moving = isfinite(all->speed_m_s) || all->clocked;
    /* Loops of known length are unrolled for the usual motions. */
    if (all->order == 3)
        moving ? bearings_of(3, 1, all) : bearings_of(3, 0, all);
    else if (all->order == 2)
        moving ? bearings_of(2, 1, all) : bearings_of(2, 0, all);
    else
        bearings_of(all->order, 1, all);
}

static PyObject *bearings(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    Bearings all;
    start(&reader, arguments, given);
    Size n = all.n = whole(&reader), knots = all.knots = whole(&reader);
    Size order = all.order = whole(&reader);
    Size e = all.e = whole(&reader);
    all.s = whole(&reader);
    Size f = all.f = whole(&reader);
    all.walks = whole(&reader);
    all.poses = whole(&reader);
    all.rounds = (int)whole(&reader);
    all.clocked = (int)whole(&reader);
    all.fast = (int)whole(&reader);
    all.noisy = (int)whole(&reader);
    all.speed_m_s = number(&reader);
    all.spin_rad_s = number(&reader);
    all.enough_s = number(&reader);
    if (!reader.failed && (order < 1 || order > MOST_ORDER || knots < 2)) {
        PyErr_SetString(PyExc_ValueError, "expected 1 to 3 blocks and two knots at least");
        reader.failed = 1;
    }
    all.knots_s = reals(&reader, knots);
    all.basis = reals(&reader, (knots - 1) * 2 * order * 3);
    all.hermite = reals(&reader, 4 * order * order);
    all.received_s = reals(&reader, n);
    all.pose = integers(&reader, n);
    all.sensor_m = reals(&reader, 3 * all.poses);
    all.axes = reals(&reader, 9 * all.poses);
    all.sensor_velocity = reals(&reader, 3 * all.poses);
    all.axes_rate = reals(&reader, 9 * all.poses);
    all.azimuth = reals(&reader, n);
    all.elevation = reals(&reader, n);
    all.turned = reals(&reader, 4 * n);
    all.tangent = reals(&reader, n);
    all.white = reals(&reader, 2 * n);
    all.light_time_s = results(&reader, n);
    all.residual = results(&reader, 2 * n);
    all.interval = whole_results(&reader, n);
    all.time_s = results(&reader, n);
    all.weights = results(&reader, n * 2 * order);
    all.by_position = results(&reader, n * 2 * 3);
    all.constant_row = integers(&reader, e);
    all.constant_channel = integers(&reader, e);
    all.constant_column = integers(&reader, e);
    all.constant_basis = reals(&reader, e);
    all.constants = reals(&reader, all.s);
    all.by_constants = results(&reader, all.by_position == NULL ? 0 : 2 * e);
    all.walk_row = integers(&reader, f);
    all.walk_channel = integers(&reader, f);
    all.walk_column = integers(&reader, f);
    all.walk_basis = reals(&reader, f);
    all.walk_time = reals(&reader, n);
    all.chains = reals(&reader, knots * all.walks);
    all.walk_before = results(&reader, f);
    all.walk_after = results(&reader, f);
    all.by_walks = results(&reader, all.by_position == NULL ? 0 : 2 * f);
    int there = all.knots_s && all.basis && all.hermite && all.received_s && all.pose && all.sensor_m &&
                all.axes && all.sensor_velocity && all.azimuth && all.elevation && all.turned &&
                all.white && all.light_time_s && all.residual && all.interval && all.time_s &&
                all.constant_row && all.constant_channel && all.constant_column &&
                all.constant_basis && all.constants && all.walk_row && all.walk_channel &&
                all.walk_column && all.walk_basis && all.walk_time && all.chains &&
                all.walk_before && all.walk_after;
    if (all.by_position != NULL)
        there = there && all.weights && all.by_constants && all.by_walks;
    if (!complete(&reader, there)) {
        release(&reader);
        return NULL;
    }
    int fits = 1;
    for (Size i = 0; i < n; i++)
        fits &= all.pose[i] >= 0 && all.pose[i] < all.poses;
    for (Size k = 0; k < e; k++)
        fits &= all.constant_channel[k] >= 0 && all.constant_channel[k] < CHANNELS &&
                all.constant_column[k] >= 0 && all.constant_column[k] < all.s;
    for (Size k = 0; k < f; k++)
        fits &= (all.walk_channel[k] == AZIMUTH || all.walk_channel[k] == ELEVATION) &&
                all.walk_column[k] >= 0 && all.walk_column[k] < all.walks;
    Size *index = malloc(sizeof(Size) * (size_t)(2 * (n + 2) + e + f));
    if (index == NULL) {
        release(&reader);
        return PyErr_NoMemory();
    }
    Py_BEGIN_ALLOW_THREADS
    Size *first_walk = index + n + 2, *entry = first_walk + n + 2, *entry_walk = entry + e;
    all.first = index;
    all.entry = entry;
    all.first_walk = first_walk;
    all.entry_walk = entry_walk;
    fits = fits && by_row(n, e, all.constant_row, index, entry) &&
           by_row(n, f, all.walk_row, first_walk, entry_walk);
    if (fits)
        bearings_all(&all);
    Py_END_ALLOW_THREADS
    free(index);
    release(&reader);
    if (!fits) {
        PyErr_SetString(PyExc_IndexError, "a row or channel is out of range");
        return NULL;
    }
    Py_RETURN_NONE;
}

/* ---------------------------------------------------------------------------------- motion */

/* Transitions under white noise whose density is that of the axes; scaled: inverse transitions,
   roots of the noise, and whitened residuals of a path. */
WIDE static void kinematics_all(Size count, Size order, const double *unit_root,
                                const double *density, const double *scale, const double *steps,
                                const double *state, double *inverse, double *root,
                                double *residual)
{
    Size m = 3 * order;
    for (Size k = 0; k < count; k++) {
        double step = steps[k], power[MOST_ORDER], taylor[MOST_ORDER];
        for (Size i = 0; i < order; i++) {
            power[i] = pow(step, (double)(order - i) - 0.5);
            taylor[i] = pow(step, (double)i) / FACTORIAL[i];
        }
        if (inverse != NULL)
            for (Size i = 0; i < order; i++)
                for (Size j = i; j < order; j++)
                    for (Size axis = 0; axis < 3; axis++) {
                        Size row = 3 * i + axis, column = 3 * j + axis;
                        double back = (j - i) % 2 ? -taylor[j - i] : taylor[j - i];
                        inverse[(k * m + row) * m + column] = back * scale[column] / scale[row];
                    }
        if (root != NULL)
            for (Size i = 0; i < order; i++)
                for (Size j = 0; j <= i; j++)
                    for (Size axis = 0; axis < 3; axis++) {
                        Size row = 3 * i + axis, column = 3 * j + axis;
                        root[(k * m + row) * m + column] =
                            power[i] * unit_root[i * order + j] * density[axis] / scale[row];
                    }
        const double *now = state + k * m, *next = now + m;
        for (Size axis = 0; axis < 3; axis++) {
            double miss[MOST_ORDER];
            for (Size i = 0; i < order; i++) {
                double gap = next[3 * i + axis];
                for (Size j = i; j < order; j++)
                    gap -= taylor[j - i] * now[3 * j + axis];
                gap /= power[i];
                for (Size j = 0; j < i; j++)
                    gap -= unit_root[i * order + j] * miss[j];
                miss[i] = gap / unit_root[i * order + i];
                residual[k * m + 3 * i + axis] = miss[i] / density[axis];
            }
        }
    }
}

static PyObject *kinematics(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size count = whole(&reader), order = whole(&reader);
    if (!reader.failed && (order < 1 || order > MOST_ORDER)) {
        PyErr_SetString(PyExc_ValueError, "expected 1 to 3 blocks");
        reader.failed = 1;
    }
    Size m = 3 * order;
    const double *unit_root = reals(&reader, order * order);
    const double *density = reals(&reader, 3);
    const double *scale = reals(&reader, m);
    const double *steps = reals(&reader, count);
    const double *state = reals(&reader, (count + 1) * m);
    double *inverse = results(&reader, count * m * m);
    double *root = results(&reader, count * m * m);
    double *residual = results(&reader, count * m);
    if (!complete(&reader, unit_root && density && scale && steps && state && residual)) {
        release(&reader);
        return NULL;
    }
    Py_BEGIN_ALLOW_THREADS
    kinematics_all(count, order, unit_root, density, scale, steps, state, inverse, root, residual);
    Py_END_ALLOW_THREADS
    release(&reader);
    Py_RETURN_NONE;
}

/* ---------------------------------------------------------------------------------- falls */

/* The Earth, as geograph.constants has it. */
typedef struct {
    double mass, j2, j3, j4, radius, spin;
} Earth;

/* factors/gravity.py: acceleration, in ECEF axes, with its derivative by the position; that by the
   velocity is 2 spin (e_x e_y' - e_y e_x'). */
INLINE void pull(const Earth *earth, int degree, const double *p, const double *v, double *value,
                 double by[3][3])
{
    double z = p[2], r2 = dot(p, p), r = sqrt(r2), spin2 = earth->spin * earth->spin;
    double mass = earth->mass / (r2 * r);
    double k = 1.5 * earth->j2 * earth->radius * earth->radius * earth->mass / (r2 * r2 * r);
    double ratio = 5.0 * z * z / r2, radial = -mass - k * (1.0 - ratio);
    double slope = (3.0 * mass + 5.0 * k * (1.0 - ratio) - 2.0 * k * ratio) / r2;
    double tilt = 10.0 * k * z / r2;
    value[0] = radial * p[0] + 2.0 * earth->spin * v[1] + spin2 * p[0];
    value[1] = radial * p[1] - 2.0 * earth->spin * v[0] + spin2 * p[1];
    value[2] = radial * z - 2.0 * k * z;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            by[i][j] = p[i] * (slope * p[j] + (j == 2 ? tilt : 0.0)) + (i == j ? radial : 0.0);
    for (int j = 0; j < 3; j++)
        by[2][j] += tilt * p[j];
    by[2][2] -= 2.0 * k;
    by[0][0] += spin2;
    by[1][1] += spin2;
    if (degree != 4)
        return;
    double u[3] = {p[0] / r, p[1] / r, p[2] / r}, s = u[2], s2 = s * s;
    double turn[3] = {-s * u[0], -s * u[1], 1.0 - s * u[2]};
    /* Of P'(n+1), P''(n+1), P'n, P''n for n = 3 and 4. */
    const double third[2] = {(35.0 * s2 * s - 15.0 * s) / 2.0, (105.0 * s2 - 15.0) / 2.0};
    const double second[2] = {(15.0 * s2 - 3.0) / 2.0, 15.0 * s};
    const double fourth[2] = {(315.0 * s2 * s2 - 210.0 * s2 + 15.0) / 8.0,
                              (315.0 * s2 * s - 105.0 * s) / 2.0};
    for (int n = 3; n <= 4; n++) {
        const double *a = n == 3 ? third : fourth, *b = n == 3 ? second : third;
        double share = earth->radius / r;
        double size = earth->mass / r2 * (n == 3 ? earth->j3 : earth->j4) * share * share * share *
                      (n == 3 ? 1.0 : share);
        for (int i = 0; i < 3; i++)
            value[i] += size * a[0] * u[i];
        value[2] -= size * b[0];
        size /= r;
        for (int j = 0; j < 3; j++) {
            double outward = size * (a[1] * turn[j] - (n + 3) * a[0] * u[j]);
            for (int i = 0; i < 3; i++)
                by[i][j] += (i == j ? size * a[0] : 0.0) + u[i] * outward;
            by[2][j] -= size * (b[1] * turn[j] - (n + 2) * b[0] * u[j]);
        }
    }
}

/* Rates of the state and of its derivative by the given state, 6 and 6 x 6. */
INLINE void fall_rates(const Earth *earth, int degree, const double *x, const double *phi,
                       double *rate, double *phi_rate)
{
    double by[3][3];
    memcpy(rate, x + 3, sizeof(double) * 3);
    pull(earth, degree, x, x + 3, rate + 3, by);
    memcpy(phi_rate, phi + 18, sizeof(double) * 18);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 6; j++)
            phi_rate[18 + 6 * i + j] =
                by[i][0] * phi[j] + by[i][1] * phi[6 + j] + by[i][2] * phi[12 + j];
    for (int j = 0; j < 6; j++) {
        phi_rate[18 + j] += 2.0 * earth->spin * phi[24 + j];
        phi_rate[24 + j] -= 2.0 * earth->spin * phi[18 + j];
    }
}

#define FALLING 42

/* One fall by classical Runge-Kutta steps of fourth order; y is the state and its derivative. */
WIDE static void fall_all(const Earth *earth, int degree, Size n, Size parts, const double *state,
                          const double *steps, double *after, double *derivative)
{
    static const double at[4] = {0.0, 0.5, 0.5, 1.0}, share[4] = {1.0, 2.0, 2.0, 1.0};
    for (Size i = 0; i < n; i++) {
        double y[FALLING] = {0.0}, h = steps[i] / (double)parts;
        memcpy(y, state + 6 * i, sizeof(double) * 6);
        for (int j = 0; j < 6; j++)
            y[6 + 7 * j] = 1.0;
        for (Size part = 0; part < parts; part++) {
            double rate[FALLING] = {0.0}, sum[FALLING] = {0.0}, now[FALLING];
            for (int stage = 0; stage < 4; stage++) {
                for (int j = 0; j < FALLING; j++)
                    now[j] = y[j] + at[stage] * h * rate[j];
                fall_rates(earth, degree, now, now + 6, rate, rate + 6);
                for (int j = 0; j < FALLING; j++)
                    sum[j] += share[stage] * rate[j];
            }
            for (int j = 0; j < FALLING; j++)
                y[j] += h / 6.0 * sum[j];
        }
        memcpy(after + 6 * i, y, sizeof(double) * 6);
        memcpy(derivative + 36 * i, y + 6, sizeof(double) * 36);
    }
}

static PyObject *fall(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size n = whole(&reader), parts = whole(&reader), degree = whole(&reader);
    if (!reader.failed && (parts < 1 || (degree != 2 && degree != 4))) {
        PyErr_SetString(PyExc_ValueError, "expected one step at least, and the degree 2 or 4");
        reader.failed = 1;
    }
    const double *earth = reals(&reader, 6);
    const double *state = reals(&reader, 6 * n);
    const double *steps = reals(&reader, n);
    double *after = results(&reader, 6 * n);
    double *derivative = results(&reader, 36 * n);
    if (!complete(&reader, earth && state && steps && after && derivative)) {
        release(&reader);
        return NULL;
    }
    Earth own = {earth[0], earth[1], earth[2], earth[3], earth[4], earth[5]};
    Py_BEGIN_ALLOW_THREADS
    fall_all(&own, (int)degree, n, parts, state, steps, after, derivative);
    Py_END_ALLOW_THREADS
    release(&reader);
    Py_RETURN_NONE;
}

/* ---------------------------------------------------------------------------------- live

   The newest end of a chain, as measurements arrive: what geograph/incremental does with few rows
   and few knots, a call for a step of it in place of dozens of small arrays. */

/* Return an array of booleans; NULL for None, or with reader->failed set. */
static const char *flags(Reader *reader, Size count)
{
    Size place = reader->next;
    PyObject *object = following(reader);
    if (object == NULL || object == Py_None)
        return NULL;
    Array *own = &reader->held[reader->count];
    if (reader->count >= MOST_ARRAYS ||
        PyObject_GetBuffer(object, &own->view, PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0) {
        if (!PyErr_Occurred())
            PyErr_SetString(PyExc_TypeError, "too many arrays");
        reader->failed = 1;
        return NULL;
    }
    reader->count++;
    if (own->view.format == NULL || strcmp(own->view.format, "?") != 0 || own->view.len != count) {
        PyErr_Format(PyExc_ValueError, "argument %zd holds %zd bytes; expected %zd booleans", place,
                     own->view.len, count);
        reader->failed = 1;
        return NULL;
    }
    return own->view.buf;
}

/* incremental/rows.py: _check, of bearings; false where it would find something. */
static PyObject *sound_bearings(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size n = whole(&reader), sensors = whole(&reader);
    const double *time = reals(&reader, n);
    const int64_t *sensor = integers(&reader, n);
    const double *azimuth = reals(&reader, n), *elevation = reals(&reader, n);
    const double *first = reals(&reader, n), *second = reals(&reader, n);
    int sound = 1;
    if (!complete(&reader, time && sensor && azimuth && elevation && first && second)) {
        release(&reader);
        return NULL;
    }
    for (Size i = 0; i < n; i++)
        sound &= isfinite(time[i]) && sensor[i] >= 0 && sensor[i] < sensors &&
                 isfinite(azimuth[i]) && !isinf(elevation[i]) && isfinite(first[i]) &&
                 first[i] > 0.0 && !isinf(second[i]) && !(second[i] <= 0.0);
    release(&reader);
    return PyBool_FromLong(sound);
}

/* incremental/room.py: emission_times, where no clock walks; from places of the sensors, or of each
   row's where they move. */
static PyObject *departures(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size n = whole(&reader), m = whole(&reader), sensors = whole(&reader), s = whole(&reader);
    double newest_s = number(&reader), speed = number(&reader);
    const double *tag_s = reals(&reader, n);
    const int64_t *sensor = integers(&reader, n);
    const double *position = reals(&reader, 3 * sensors);
    const int64_t *bias = integers(&reader, sensors * CHANNELS);
    const int64_t *drift = integers(&reader, sensors * CHANNELS);
    const double *since_s = reals(&reader, sensors * CHANNELS), *sigma = reals(&reader, s);
    const double *constants = reals(&reader, s), *state = reals(&reader, m);
    const double *places = reals(&reader, 3 * n);
    double *emitted = results(&reader, n), *delay = results(&reader, n);
    int fits = 1;
    if (!complete(&reader, tag_s && sensor && position && bias && drift && since_s && sigma &&
                               constants && state && emitted && delay && m >= 3)) {
        release(&reader);
        return NULL;
    }
    for (Size i = 0; i < n; i++) {
        if (sensor[i] < 0 || sensor[i] >= sensors) {
            fits = 0;
            break;
        }
        Size place = (Size)sensor[i] * CHANNELS + CLOCK;
        double received = tag_s[i], away[3];
        if (bias[place] >= s || drift[place] >= s) {
            fits = 0;
            break;
        }
        if (bias[place] >= 0)
            received -= constants[bias[place]] * sigma[bias[place]];
        if (drift[place] >= 0)
            received -= constants[drift[place]] * sigma[drift[place]] * (tag_s[i] - since_s[place]);
        for (int j = 0; j < 3; j++) {
            away[j] = state[j] - (places ? places[3 * i + j] : position[3 * sensor[i] + j]);
            if (m > 3)
                away[j] += (received - newest_s) * state[3 + j];
        }
        emitted[i] = isfinite(speed) ? received - sqrt(dot(away, away)) / speed : received;
        delay[i] = received - emitted[i];
    }
    release(&reader);
    if (!fits) {
        PyErr_SetString(PyExc_IndexError, "a sensor or column is out of range");
        return NULL;
    }
    Py_RETURN_NONE;
}

/* One interval of a chain, with the rows of bearings in it. */
typedef struct {
    Size n, order, sensors, s, walks;
    int clocked, level_noise, rounds, loss;
    double speed_m_s, spin_rad_s, enough_s, zenith, tuning, low_s, high_s, knots_s[2];
    const double *time_s, *azimuth, *elevation, *sigma_azimuth, *sigma_elevation, *delay_s;
    const int64_t *sensor;
    const char *isotropic, *kept;
    const double *position, *axes, *since_s, *sigma, *walk_scale, *diffusion;
    const double *row_position, *row_velocity, *row_axes, *row_axes_rate; /* where sensors move */
    const int64_t *bias, *drift, *walk;
    const double *hermite, *unit_root, *density, *scale;
    const double *path[2], *reference_path[2], *chains[2], *reference_chains[2];
    const double *constants, *reference;
    double *block, *inverse, *root, *noise, *at_path, *at_chains, *emitted_s, *residual;
} LiveInterval;

/* Work of an interval: everything in one piece of memory. */
typedef struct {
    double *velocity, *white, *tangent, *turned, *received, *delay, *weights;
    double *by_position, *weight, *basis, *by_constants, *walk_basis, *walk_time, *before, *after;
    double *by_walks, *chains, *pair, *others, *ahead;
    int64_t *interval, *pose, *row, *channel, *column, *walk_row, *walk_channel, *walk_column;
    Size *index;
} LiveRoom;

static double *carve(double **free, Size count)
{
    double *own = *free;
    *free += count;
    return own;
}

/* Make room for an interval; NULL without memory. All that is held has eight bytes. */
static double *live_room(const LiveInterval *own, Size e, Size f, LiveRoom *room)
{
    Size n = own->n, d = 3 * own->order + own->walks, c = own->s + 1, order = own->order;
    Size touched = c + 2 * own->walks, sensors = own->sensors;
    Size reals = 3 * sensors + n * (2 + 1 + 4 + 1 + 1 + 2 * order + 6 + 1 + 1 + 1 + 1) + 3 * e +
                 5 * f + 2 * own->walks + 6 * order + c * c + 2 * d + c;
    Size entries = 3 * (e + f) + 2 * (n + 2) + e + f + 2 * touched;
    double *all = calloc((size_t)(reals + entries + 8), 8), *free = all;
    if (all == NULL)
        return NULL;
    room->velocity = carve(&free, 3 * sensors);
    room->white = carve(&free, 2 * n);
    room->tangent = carve(&free, n);
    room->turned = carve(&free, 4 * n);
    room->received = carve(&free, n);
    room->delay = carve(&free, n);
    room->weights = carve(&free, 2 * order * n);
    room->by_position = carve(&free, 6 * n);
    room->weight = carve(&free, n);
    room->walk_time = carve(&free, n);
    room->interval = (int64_t *)carve(&free, n);
    room->pose = (int64_t *)carve(&free, n);
    room->basis = carve(&free, e);
    room->by_constants = carve(&free, 2 * e);
    room->walk_basis = carve(&free, f);
    room->before = carve(&free, f);
    room->after = carve(&free, f);
    room->by_walks = carve(&free, 2 * f);
    room->chains = carve(&free, 2 * own->walks);
    room->pair = carve(&free, 6 * order);
    room->others = carve(&free, c * c);
    room->ahead = carve(&free, 2 * d + c);
    room->row = (int64_t *)carve(&free, e);
    room->channel = (int64_t *)carve(&free, e);
    room->column = (int64_t *)carve(&free, e);
    room->walk_row = (int64_t *)carve(&free, f);
    room->walk_channel = (int64_t *)carve(&free, f);
    room->walk_column = (int64_t *)carve(&free, f);
    room->index = (Size *)free;
    return all;
}

/* Count the entries of the derivatives by constants and walks; 0 if an index is out of range. */
static int count_entries(const LiveInterval *own, Size *e, Size *f)
{
    *e = *f = 0;
    for (Size i = 0; i < own->n; i++) {
        if (own->sensor[i] < 0 || own->sensor[i] >= own->sensors)
            return 0;
        Size first = (Size)own->sensor[i] * CHANNELS;
        for (Size channel = first; channel < first + CHANNELS; channel++) {
            if (own->bias[channel] >= own->s || own->drift[channel] >= own->s ||
                own->walk[channel] >= own->walks)
                return 0;
            *e += (own->bias[channel] >= 0) + (own->drift[channel] >= 0);
            *f += own->walk[channel] >= 0;
        }
    }
    return 1;
}

/* losses.py: the weight of a squared residual. */
enum { NO_LOSS = 0, HUBER = 1, CAUCHY = 2, GEMAN_MCCLURE = 3 };

static double weight_of(int loss, double tuning, double square)
{
    double scale = tuning * tuning;
    if (loss == HUBER)
        return square > scale ? tuning / sqrt(square) : 1.0;
    if (loss == CAUCHY)
        return 1.0 / (1.0 + square / scale);
    if (loss == GEMAN_MCCLURE) {
        double share = scale / (scale + square);
        return share * share;
    }
    return 1.0;
}

/* What families/bearings.py and states.py make of rows when a family is built: poses of sensors that
   stand still, reciprocals of sigmas, and which row feels which state. Walks are of directions. */
static void lay_out_rows(const LiveInterval *own, LiveRoom *room, Bearings *all)
{
    int uniform = 1;
    Size e = 0, f = 0;
    for (Size i = 0; i < own->n; i++) {
        Size sensor = (Size)own->sensor[i], first = sensor * CHANNELS;
        int lone = isnan(own->elevation[i]), tangent = own->isotropic[i] && !lone;
        double level = lone ? 0.0 : own->elevation[i], received = 0.0;
        room->pose[i] = own->row_position == NULL ? (int64_t)sensor : (int64_t)i;
        room->turned[4 * i] = cos(own->azimuth[i]);
        room->turned[4 * i + 1] = sin(own->azimuth[i]);
        room->turned[4 * i + 2] = cos(level);
        room->turned[4 * i + 3] = sin(level);
        room->tangent[i] = tangent;
        uniform &= tangent;
        room->white[2 * i] = 1.0 / own->sigma_azimuth[i];
        room->white[2 * i + 1] = lone ? 0.0 : 1.0 / own->sigma_elevation[i];
        if (!tangent && !lone && room->turned[4 * i + 2] < own->zenith)
            /* At the zenith a coordinate's azimuth says nothing, however small its sigma. */
            room->white[2 * i] = 0.0;
        room->weight[i] = own->kept[i] ? 1.0 : 0.0;
        for (int drift = 0; drift < 2; drift++)
            for (Size channel = 0; channel < CHANNELS; channel++) {
                int64_t column = (drift ? own->drift : own->bias)[first + channel];
                if (column < 0)
                    continue;
                double basis = drift ? own->time_s[i] - own->since_s[first + channel] : 1.0;
                room->row[e] = (int64_t)i;
                room->channel[e] = (int64_t)channel;
                room->column[e] = column;
                room->basis[e] = basis * own->sigma[column];
                if (channel == CLOCK)
                    received += room->basis[e] * own->constants[column];
                e++;
            }
        for (Size channel = 0; channel < CHANNELS; channel++) {
            int64_t column = own->walk[first + channel];
            if (column < 0)
                continue;
            room->walk_row[f] = (int64_t)i;
            room->walk_channel[f] = (int64_t)channel;
            room->walk_column[f] = column;
            room->walk_basis[f++] = own->walk_scale[column];
        }
        room->received[i] = own->time_s[i] - received;
        room->delay[i] = own->delay_s[i];
        room->walk_time[i] = own->time_s[i];
    }
    all->e = e;
    all->f = f;
    all->tangent = uniform ? NULL : room->tangent;
}

/* Evaluate the rows of an interval, and add them up in "block". */
static int evaluate_rows(const LiveInterval *own, LiveRoom *room)
{
    Size order = own->order, m = 3 * order, d = m + own->walks, c = own->s + 1;
    Bearings all;
    memset(&all, 0, sizeof all);
    all.n = own->n;
    all.knots = 2;
    all.order = order;
    all.s = own->s;
    all.walks = own->walks;
    lay_out_rows(own, room, &all);
    memcpy(room->pair, own->path[0], sizeof(double) * (size_t)m);
    memcpy(room->pair + m, own->path[1], sizeof(double) * (size_t)m);
    memcpy(room->chains, own->chains[0], sizeof(double) * (size_t)own->walks);
    memcpy(room->chains + own->walks, own->chains[1], sizeof(double) * (size_t)own->walks);
    all.knots_s = own->knots_s;
    all.basis = room->pair;
    all.hermite = own->hermite;
    all.received_s = room->received;
    int moving = own->row_position != NULL;
    all.pose = room->pose;
    all.poses = moving ? own->n : own->sensors;
    all.sensor_m = moving ? own->row_position : own->position;
    all.axes = moving ? own->row_axes : own->axes;
    all.sensor_velocity = moving ? own->row_velocity : room->velocity;
    all.axes_rate = own->row_axes_rate;
    all.azimuth = own->azimuth;
    all.elevation = own->elevation;
    all.turned = room->turned;
    all.noisy = own->level_noise;
    all.white = room->white;
    all.speed_m_s = own->speed_m_s;
    all.spin_rad_s = own->spin_rad_s;
    all.enough_s = own->enough_s;
    all.clocked = own->clocked;
    all.rounds = own->rounds;
    all.light_time_s = room->delay;
    all.residual = own->residual;
    all.interval = room->interval;
    all.time_s = own->emitted_s;
    all.weights = room->weights;
    all.by_position = room->by_position;
    all.constant_row = room->row;
    all.constant_channel = room->channel;
    all.constant_column = room->column;
    all.constant_basis = room->basis;
    all.constants = own->constants;
    all.by_constants = room->by_constants;
    all.walk_row = room->walk_row;
    all.walk_channel = room->walk_channel;
    all.walk_column = room->walk_column;
    all.walk_basis = room->walk_basis;
    all.walk_time = room->walk_time;
    all.chains = room->chains;
    all.walk_before = room->before;
    all.walk_after = room->after;
    all.by_walks = room->by_walks;
    Size *first = room->index, *first_walk = first + own->n + 2;
    Size *entry = first_walk + own->n + 2, *entry_walk = entry + all.e;
    all.first = first;
    all.entry = entry;
    all.first_walk = first_walk;
    all.entry_walk = entry_walk;
    if (!by_row(own->n, all.e, room->row, first, entry) ||
        !by_row(own->n, all.f, room->walk_row, first_walk, entry_walk))
        return 0;
    bearings_all(&all);
    if (own->walks) {
        /* Walks are read at the emission, as it was found before. */
        memcpy(room->walk_time, own->emitted_s, sizeof(double) * (size_t)own->n);
        bearings_all(&all);
    }
    int all_count = 1;
    for (Size i = 0; i < own->n; i++) {
        const double *miss = own->residual + 2 * i;
        if (own->loss != NO_LOSS && room->weight[i] > 0.0)
            room->weight[i] = sqrt(
                weight_of(own->loss, own->tuning, miss[0] * miss[0] + miss[1] * miss[1]));
        all_count &= room->weight[i] == 1.0;
    }
    Blocks sums;
    memset(&sums, 0, sizeof sums);
    sums.n = own->n;
    sums.r = 2;
    sums.intervals = sums.held = 1;
    sums.path = m;
    sums.walks = own->walks;
    sums.constants = own->s;
    sums.order = order;
    sums.e = all.e;
    sums.f = all.f;
    sums.chained = 1;
    sums.knots = own->block;
    sums.others = room->others;
    sums.residual = own->residual;
    sums.by_path = room->by_position;
    sums.weights = room->weights;
    sums.scale = own->scale;
    sums.by_constants = room->by_constants;
    sums.before = room->before;
    sums.after = room->after;
    sums.by_walks = room->by_walks;
    sums.weight = all_count ? NULL : room->weight;
    sums.interval = room->interval;
    sums.constant_row = room->row;
    sums.constant_column = room->column;
    sums.walk_row = room->walk_row;
    sums.walk_column = room->walk_column;
    sums.first = first;
    sums.entry = entry;
    sums.first_walk = first_walk;
    sums.entry_walk = entry_walk;
    Held held;
    held.from = entry_walk + all.f;
    held.at = held.from + c + 2 * own->walks;
    double *own_room = make_room(&sums, 2 * d, &held);
    held.touched = calloc((size_t)(c + 2 * own->walks), 1);
    int good = own_room != NULL && held.touched != NULL && add_all(&sums, &held);
    free(own_room);
    free(held.touched);
    return good;
}

/* Fill in the rest of a whole block, and write it about the chain's reference: 0 if it is not
   finite. */
WIDE static int refer(const LiveInterval *own, LiveRoom *room)
{
    Size m = 3 * own->order, d = m + own->walks, c = own->s + 1, width = 2 * d + c;
    double *block = own->block, *ahead = room->ahead, total = 0.0;
    for (Size i = 0; i < c; i++) {
        double *row = block + (2 * d + i) * width;
        for (Size j = 0; j < 2 * d; j++)
            row[j] = block[j * width + 2 * d + i];
        memcpy(row + 2 * d, room->others + i * c, sizeof(double) * (size_t)c);
    }
    for (Size i = 0; i < width * width; i++)
        total += block[i];
    if (!isfinite(total))
        return 0;
    int moved = 0;
    for (Size half = 0; half < 2; half++) {
        for (Size j = 0; j < m; j++)
            ahead[half * d + j] = (own->path[half][j] - own->reference_path[half][j]) / own->scale[j];
        for (Size j = 0; j < own->walks; j++)
            ahead[half * d + m + j] = own->chains[half][j] - own->reference_chains[half][j];
    }
    for (Size j = 0; j < own->s; j++)
        ahead[2 * d + j] = own->constants[j] - own->reference[j];
    for (Size j = 0; j < width - 1; j++)
        moved |= ahead[j] != 0.0;
    for (Size i = 0; moved && i < width - 1; i++) {
        double by = 0.0;
        for (Size j = 0; j < width - 1; j++)
            by += block[i * width + j] * ahead[j];
        block[i * width + width - 1] -= by;
    }
    for (Size i = 0; moved && i < width - 1; i++)
        block[(width - 1) * width + i] = block[i * width + width - 1];
    return 1;
}

/* incremental/model.py: _transitions, of motions whose transitions are the same everywhere. */
static void follow(const LiveInterval *own)
{
    Size m = 3 * own->order, d = m + own->walks;
    double step = own->knots_s[1] - own->knots_s[0];
    double pair[6 * MOST_ORDER], by[9 * MOST_ORDER * MOST_ORDER] = {0.0};
    double root[9 * MOST_ORDER * MOST_ORDER] = {0.0};
    memcpy(pair, own->reference_path[0], sizeof(double) * (size_t)m);
    memcpy(pair + m, own->reference_path[1], sizeof(double) * (size_t)m);
    kinematics_all(1, own->order, own->unit_root, own->density, own->scale, &step, pair, by, root,
                   own->noise);
    memset(own->inverse, 0, sizeof(double) * (size_t)(d * d));
    memset(own->root, 0, sizeof(double) * (size_t)(d * d));
    for (Size i = 0; i < m; i++) {
        memcpy(own->inverse + i * d, by + i * m, sizeof(double) * (size_t)m);
        memcpy(own->root + i * d, root + i * m, sizeof(double) * (size_t)m);
    }
    for (Size j = 0; j < own->walks; j++) {
        Size at = (m + j) * d + m + j;
        own->inverse[at] = 1.0;
        own->root[at] = own->diffusion[j] * sqrt(step) / own->walk_scale[j];
        own->noise[m + j] =
            (own->reference_chains[1][j] - own->reference_chains[0][j]) / own->root[at];
    }
}

/* 1: done; 0: rows are elsewhere; -1: not finite; -2: no memory; -3: out of range. */
static int linearise_interval(const LiveInterval *own)
{
    Size m = 3 * own->order, d = m + own->walks, width = 2 * d + own->s + 1, e, f;
    if (!count_entries(own, &e, &f))
        return -3;
    LiveRoom room;
    double *memory = live_room(own, e, f, &room);
    if (memory == NULL)
        return -2;
    int found = 1;
    memset(own->block, 0, sizeof(double) * (size_t)(width * width));
    if (!evaluate_rows(own, &room))
        found = -2;
    for (Size i = 0; found == 1 && i < own->n; i++)
        if (own->emitted_s[i] < own->low_s || own->emitted_s[i] > own->high_s)
            found = 0;
    if (found == 1 && !refer(own, &room))
        found = -1;
    if (found == 1) {
        follow(own);
        for (Size half = 0; half < 2; half++) {
            memcpy(own->at_path + half * m, own->path[half], sizeof(double) * (size_t)m);
            memcpy(own->at_chains + half * own->walks, own->chains[half],
                   sizeof(double) * (size_t)own->walks);
        }
    }
    free(memory);
    return found;
}

static PyObject *live_interval(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    LiveInterval all;
    start(&reader, arguments, given);
    Size n = all.n = whole(&reader), order = all.order = whole(&reader);
    Size sensors = all.sensors = whole(&reader), s = all.s = whole(&reader);
    Size walks = all.walks = whole(&reader);
    all.clocked = (int)whole(&reader);
    all.level_noise = (int)whole(&reader);
    all.rounds = (int)whole(&reader);
    all.loss = (int)whole(&reader);
    all.speed_m_s = number(&reader);
    all.spin_rad_s = number(&reader);
    all.enough_s = number(&reader);
    all.zenith = number(&reader);
    all.tuning = number(&reader);
    all.hermite = reals(&reader, 4 * order * order);
    all.unit_root = reals(&reader, order * order);
    all.scale = reals(&reader, 3 * order);
    all.position = reals(&reader, 3 * sensors);
    all.axes = reals(&reader, 9 * sensors);
    all.bias = integers(&reader, sensors * CHANNELS);
    all.drift = integers(&reader, sensors * CHANNELS);
    all.since_s = reals(&reader, sensors * CHANNELS);
    all.sigma = reals(&reader, s);
    all.walk = integers(&reader, sensors * CHANNELS);
    all.walk_scale = reals(&reader, walks);
    all.diffusion = reals(&reader, walks);
    all.density = reals(&reader, 3);
    all.low_s = number(&reader);
    all.high_s = number(&reader);
    all.knots_s[0] = number(&reader);
    all.knots_s[1] = number(&reader);
    all.time_s = reals(&reader, n);
    all.sensor = integers(&reader, n);
    all.azimuth = reals(&reader, n);
    all.elevation = reals(&reader, n);
    all.sigma_azimuth = reals(&reader, n);
    all.sigma_elevation = reals(&reader, n);
    all.isotropic = flags(&reader, n);
    all.kept = flags(&reader, n);
    all.delay_s = reals(&reader, n);
    all.row_position = reals(&reader, 3 * n);
    all.row_velocity = reals(&reader, 3 * n);
    all.row_axes = reals(&reader, 9 * n);
    all.row_axes_rate = reals(&reader, 9 * n);
    Size m = 3 * order, d = m + walks, width = 2 * d + s + 1;
    for (int half = 0; half < 2; half++) {
        all.path[half] = reals(&reader, m);
        all.reference_path[half] = reals(&reader, m);
        all.chains[half] = reals(&reader, walks);
        all.reference_chains[half] = reals(&reader, walks);
    }
    all.constants = reals(&reader, s);
    all.reference = reals(&reader, s);
    all.block = results(&reader, width * width);
    all.inverse = results(&reader, d * d);
    all.root = results(&reader, d * d);
    all.noise = results(&reader, d);
    all.at_path = results(&reader, 2 * m);
    all.at_chains = results(&reader, 2 * walks);
    all.emitted_s = results(&reader, n);
    all.residual = results(&reader, 2 * n);
    int there = all.hermite && all.unit_root && all.scale && all.position && all.axes && all.bias &&
                all.drift && all.since_s && all.sigma && all.walk && all.walk_scale &&
                all.diffusion && all.density && all.time_s && all.sensor && all.azimuth &&
                all.elevation && all.sigma_azimuth && all.sigma_elevation && all.isotropic &&
                all.kept && all.delay_s && all.path[0] && all.path[1] && all.reference_path[0] &&
                all.reference_path[1] && all.chains[0] && all.chains[1] && all.reference_chains[0] &&
                all.reference_chains[1] && all.constants && all.reference && all.block &&
                all.inverse && all.root && all.noise && all.at_path && all.at_chains &&
                all.emitted_s && all.residual &&
                !all.row_position == !all.row_velocity && !all.row_position == !all.row_axes &&
                order >= 1 && order <= MOST_ORDER;
    if (!complete(&reader, there)) {
        release(&reader);
        return NULL;
    }
    int found;
    Py_BEGIN_ALLOW_THREADS
    found = linearise_interval(&all);
    Py_END_ALLOW_THREADS
    release(&reader);
    if (found == -2)
        return PyErr_NoMemory();
    if (found == -3) {
        PyErr_SetString(PyExc_IndexError, "a sensor or column is out of range");
        return NULL;
    }
    return PyLong_FromLong(found);
}

/* incremental/chain.py: one interval of a sweep, which adds to what is known of the constants. */
static PyObject *live_eliminate(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    Sweep all;
    memset(&all, 0, sizeof all);
    start(&reader, arguments, given);
    Size d = all.d = whole(&reader), c = all.c = whole(&reader), w = d + c, width = w + d;
    double sums[2] = {0.0, 0.0};
    all.n = 1;
    all.sums = sums;
    all.knot = reals(&reader, d * w);
    const double *known = reals(&reader, c * c), *block = reals(&reader, width * width);
    all.blocks = block;
    all.inverse_transition = reals(&reader, d * d);
    all.noise_root = reals(&reader, d * d);
    all.noise_residual = reals(&reader, d);
    all.knots = results(&reader, d * w);
    all.shares = results(&reader, c * c);
    all.back = results(&reader, d * w);
    all.spread = results(&reader, d * d);
    if (!complete(&reader, all.knot && known && block && all.inverse_transition && all.noise_root &&
                               all.noise_residual && all.knots && all.shares && all.back &&
                               all.spread && c > 0)) {
        release(&reader);
        return NULL;
    }
    Size working = room_for(d, c) + d * PADDED(w) + 1;
    double *work = malloc(sizeof(double) * (size_t)(working + c * c));
    if (work == NULL) {
        release(&reader);
        return PyErr_NoMemory();
    }
    int good;
    Py_BEGIN_ALLOW_THREADS
    double *others = work + working;
    for (Size i = 0; i < c; i++)
        for (Size j = 0; j < c; j++)
            others[i * c + j] = known[i * c + j] + block[(2 * d + i) * width + 2 * d + j];
    all.others = others;
    good = sweep_all(&all, work);
    Py_END_ALLOW_THREADS
    free(work);
    release(&reader);
    return PyBool_FromLong(good);
}

/* incremental/chain.py: _finish. The lower factor of the information of the newest knot and the
   constants, its upper triangle zero, and the step that it gives. */
#define LEAST_PIVOT 1e-300 /* so that the covariance is finite */

WIDE static int finish_all(Size d, Size c, const double *knot, const double *other,
                           const double *hold, double *root, double *step)
{
    Size w = d + c, n = w - 1;
    for (Size i = 0; i < d; i++) {
        memcpy(root + i * n, knot + i * w, sizeof(double) * (size_t)(i + 1));
        step[i] = -knot[i * w + w - 1];
    }
    for (Size i = 0; i < c - 1; i++) {
        double *row = root + (d + i) * n;
        for (Size j = 0; j < d; j++)
            row[j] = knot[j * w + d + i];
        for (Size j = 0; j <= i; j++)
            row[d + j] = other[i * c + j] + hold[i * c + j];
        step[d + i] = -(other[i * c + c - 1] + hold[i * c + c - 1]);
    }
    for (Size i = 0; i < n; i++) {
        double *row = root + i * n;
        memset(row + i + 1, 0, sizeof(double) * (size_t)(n - i - 1));
        for (Size j = 0; j <= i; j++) {
            const double *column = root + j * n;
            double value = row[j];
            for (Size k = 0; k < j; k++)
                value -= row[k] * column[k];
            if (j < i)
                row[j] = value / column[j];
            else if (value > LEAST_PIVOT && isfinite(value))
                row[j] = sqrt(value);
            else
                return 0;
        }
    }
    for (Size i = 0; i < n; i++) {
        for (Size k = 0; k < i; k++)
            step[i] -= root[i * n + k] * step[k];
        step[i] /= root[i * n + i];
    }
    for (Size i = n - 1; i >= 0; i--) {
        step[i] /= root[i * n + i];
        for (Size k = 0; k < i; k++)
            step[k] -= root[i * n + k] * step[i];
    }
    for (Size i = 0; i < n; i++)
        if (!isfinite(step[i]))
            return 0;
    return 1;
}

static PyObject *live_finish(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size d = whole(&reader), c = whole(&reader), w = d + c;
    const double *knot = reals(&reader, d * w), *other = reals(&reader, c * c);
    const double *hold = reals(&reader, c * c);
    double *root = results(&reader, (w - 1) * (w - 1)), *step = results(&reader, w - 1);
    if (!complete(&reader, knot && other && hold && root && step && c > 0)) {
        release(&reader);
        return NULL;
    }
    int good;
    Py_BEGIN_ALLOW_THREADS
    good = finish_all(d, c, knot, other, hold, root, step);
    Py_END_ALLOW_THREADS
    release(&reader);
    return PyBool_FromLong(good);
}

/* The inverse of R R', R a lower factor. */
WIDE static void spread_all(Size n, const double *root, double *work, double *covariance)
{
    memset(work, 0, sizeof(double) * (size_t)(n * n));
    memset(covariance, 0, sizeof(double) * (size_t)(n * n));
    for (Size i = 0; i < n; i++) {
        /* Row i of the inverse factor, from those before. */
        double *row = work + i * n, by = 1.0 / root[i * n + i];
        for (Size k = 0; k < i; k++) {
            double share = -root[i * n + k] * by;
            const double *before = work + k * n;
            for (Size j = 0; j <= k; j++)
                row[j] += share * before[j];
        }
        row[i] = by;
        for (Size a = 0; a <= i; a++) {
            double share = row[a];
            double *restrict out = covariance + a * n;
            for (Size b = 0; b <= a; b++)
                out[b] += share * row[b];
        }
    }
    mirror(n, covariance);
}

static PyObject *live_covariance(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size n = whole(&reader);
    const double *root = reals(&reader, n * n);
    double *covariance = results(&reader, n * n);
    if (!complete(&reader, root && covariance)) {
        release(&reader);
        return NULL;
    }
    double *work = malloc(sizeof(double) * (size_t)(n * n + 1));
    if (work == NULL) {
        release(&reader);
        return PyErr_NoMemory();
    }
    Py_BEGIN_ALLOW_THREADS
    spread_all(n, root, work, covariance);
    Py_END_ALLOW_THREADS
    free(work);
    release(&reader);
    Py_RETURN_NONE;
}

/* incremental/chain.py: solve, of one knot. Its offset from the one after it, or as it is given
   where "back" is None, and its estimate. */
static PyObject *live_place(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size d = whole(&reader), c = whole(&reader), m = whole(&reader);
    const double *back = reals(&reader, d * (d + c)), *step = reals(&reader, d + c - 1);
    const double *next = reals(&reader, d), *scale = reals(&reader, d);
    const double *reference_path = reals(&reader, m), *reference_chains = reals(&reader, d - m);
    double *offset = results(&reader, d), *path = results(&reader, m);
    double *chains = results(&reader, d - m);
    if (!complete(&reader, step && (next || !back) && scale && reference_path && reference_chains &&
                               offset && path && chains && c > 0 && m <= d)) {
        release(&reader);
        return NULL;
    }
    for (Size i = 0; i < d; i++) {
        double value = step[i];
        if (back != NULL) {
            const double *row = back + i * (d + c);
            value = row[d + c - 1];
            for (Size j = 0; j < d; j++)
                value += row[j] * next[j];
            for (Size j = d; j < d + c - 1; j++)
                value += row[j] * step[j];
        }
        offset[i] = value;
        if (i < m)
            path[i] = reference_path[i] + value * scale[i];
        else
            chains[i - m] = reference_chains[i - m] + value;
    }
    release(&reader);
    Py_RETURN_NONE;
}

/* incremental/curvature.py: Limits.moved, of one interval. */
static PyObject *live_moved(PyObject *self, PyObject *const *arguments, Size given)
{
    (void)self;
    Reader reader;
    start(&reader, arguments, given);
    Size blocks = whole(&reader), m = whole(&reader), walks = whole(&reader), s = whole(&reader);
    const double *scale = reals(&reader, m + walks), *most_path = reals(&reader, blocks);
    const double *most_chains = reals(&reader, walks), *most_constants = reals(&reader, s);
    const double *path[2], *chains[2];
    path[0] = reals(&reader, m);
    path[1] = reals(&reader, m);
    const double *at_path = reals(&reader, 2 * m);
    chains[0] = reals(&reader, walks);
    chains[1] = reals(&reader, walks);
    const double *at_chains = reals(&reader, 2 * walks);
    const double *constants = reals(&reader, s), *at_constants = reals(&reader, s);
    if (!complete(&reader, scale && most_path && most_chains && most_constants && path[0] &&
                               path[1] && at_path && chains[0] && chains[1] && at_chains &&
                               constants && at_constants && 3 * blocks <= m)) {
        release(&reader);
        return NULL;
    }
    int far = 0;
    for (Size half = 0; half < 2; half++) {
        for (Size block = 0; block < blocks; block++) {
            double square = 0.0;
            for (Size j = 3 * block; j < 3 * block + 3; j++) {
                double gap = (path[half][j] - at_path[half * m + j]) / scale[j];
                square += gap * gap;
            }
            far |= sqrt(square) > most_path[block];
        }
        for (Size j = 0; j < walks; j++)
            far |= fabs(chains[half][j] - at_chains[half * walks + j]) > most_chains[j];
    }
    for (Size j = 0; j < s; j++)
        far |= fabs(constants[j] - at_constants[j]) > most_constants[j];
    release(&reader);
    return PyBool_FromLong(far);
}

/* ---------------------------------------------------------------------------------- radio */

#include "_radio.c"

/* ---------------------------------------------------------------------------------- module */

static PyMethodDef methods[] = {
    {"sweep", (PyCFunction)(void (*)(void))sweep, METH_FASTCALL, "geograph.sweep.sweep"},
    {"marginals", (PyCFunction)(void (*)(void))marginals, METH_FASTCALL,
     "geograph.sweep.chain_marginals"},
    {"substitute", (PyCFunction)(void (*)(void))substitute, METH_FASTCALL,
     "The back substitution of geograph.eliminate.Factorisation.solve"},
    {"substitute_later", (PyCFunction)(void (*)(void))substitute_later, METH_FASTCALL,
     "geograph.sweep.Ends.substitute"},
    {"turn_back", (PyCFunction)(void (*)(void))turn_back_later, METH_FASTCALL,
     "geograph.sweep.Ends.turned_back"},
    {"add_blocks", (PyCFunction)(void (*)(void))add_blocks, METH_FASTCALL,
     "geograph.blocks.BlockSum.add"},
    {"bearings", (PyCFunction)(void (*)(void))bearings, METH_FASTCALL,
     "geograph.families.bearings.BearingFamily.evaluate"},
    {"kinematics", (PyCFunction)(void (*)(void))kinematics, METH_FASTCALL,
     "geograph.motion.Motion.linear"},
    {"fall", (PyCFunction)(void (*)(void))fall, METH_FASTCALL,
     "geograph.factors.gravity.propagate"},
    {"sound_bearings", (PyCFunction)(void (*)(void))sound_bearings, METH_FASTCALL,
     "The checks of geograph.incremental.rows.read"},
    {"departures", (PyCFunction)(void (*)(void))departures, METH_FASTCALL,
     "geograph.incremental.room.emission_times"},
    {"live_interval", (PyCFunction)(void (*)(void))live_interval, METH_FASTCALL,
     "geograph.incremental.model.Model.linearise, of one interval"},
    {"live_eliminate", (PyCFunction)(void (*)(void))live_eliminate, METH_FASTCALL,
     "geograph.sweep.sweep, of one interval"},
    {"live_finish", (PyCFunction)(void (*)(void))live_finish, METH_FASTCALL,
     "The end of geograph.incremental.chain.Chain.eliminate"},
    {"live_covariance", (PyCFunction)(void (*)(void))live_covariance, METH_FASTCALL,
     "geograph.incremental.chain.Final.covariance"},
    {"live_place", (PyCFunction)(void (*)(void))live_place, METH_FASTCALL,
     "geograph.incremental.chain.Chain.solve, of one knot"},
    {"live_moved", (PyCFunction)(void (*)(void))live_moved, METH_FASTCALL,
     "geograph.incremental.curvature.Limits.moved, of one interval"},

    {"radio_plan", (PyCFunction)(void (*)(void))radio_plan, METH_FASTCALL,
     "What the two that follow need and no solve changes"},
    {"radio", (PyCFunction)(void (*)(void))radio, METH_FASTCALL,
     "geograph.families.rays.RayFamily.evaluate"},
    {"radio_sums", (PyCFunction)(void (*)(void))radio_sums, METH_FASTCALL,
     "The same with geograph.common.settled and geograph.blocks.BlockSum.add"},
    {"settle", (PyCFunction)(void (*)(void))settle, METH_FASTCALL, "geograph.common.settled"},
    {"add_shared", (PyCFunction)(void (*)(void))add_shared, METH_FASTCALL,
     "geograph.blocks.BlockSum.add, of measurements that share unknowns"},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, "_compiled", "The hot loops in C.", -1, methods, NULL, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__compiled(void)
{
    PyObject *made = PyModule_Create(&module);
    if (made == NULL)
        return NULL;
    const struct {
        const char *name;
        long value;
    } channels[] = {{"AZIMUTH", AZIMUTH},   {"ELEVATION", ELEVATION}, {"CLOCK", CLOCK},
                    {"POSITION", POSITION}, {"VELOCITY", VELOCITY},   {"SPEED", SPEED},
                    {"FREQUENCY", FREQUENCY}, {"CHANNELS", CHANNELS}};
    for (size_t i = 0; i < sizeof channels / sizeof channels[0]; i++)
        if (PyModule_AddIntConstant(made, channels[i].name, channels[i].value) < 0) {
            Py_DECREF(made);
            return NULL;
        }
    return made;
}
