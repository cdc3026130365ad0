/* Sums of products of measurements, an interval of the chain at a time (geograph/blocks.py). */

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
