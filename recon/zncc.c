#include "recon/zncc.h"

#include <math.h>

double td_zncc(const td_image *a, int i, int j, const td_image *b, int l, int m, int k)
{
    if (i < k || j < k || i >= a->width - k || j >= a->height - k || l < k || m < k || l >= b->width - k ||
        m >= b->height - k)
        return NAN;
    double n = (2.0 * k + 1) * (2.0 * k + 1), sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
    for (int dy = -k; dy <= k; dy++)
        for (int dx = -k; dx <= k; dx++) {
            double p = a->data[(size_t)(j + dy) * (size_t)a->width + (size_t)(i + dx)];
            double q = b->data[(size_t)(m + dy) * (size_t)b->width + (size_t)(l + dx)];
            sa += p;
            sb += q;
            saa += p * p;
            sbb += q * q;
            sab += p * q;
        }
    /* Sums of bytes and of their products are whole numbers below 2^53: nothing is rounded before here. */
    double va = n * saa - sa * sa, vb = n * sbb - sb * sb;
    return va > 0 && vb > 0 ? (n * sab - sa * sb) / (sqrt(va) * sqrt(vb)) : NAN;
}
