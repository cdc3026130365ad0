/* Small dense matrices, padded to whole registers. */

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
