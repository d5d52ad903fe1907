#include "calib/tag_dictionary_internal.h"

#include <opencv2/aruco/dictionary.hpp>

bool td_aruco_bits(uint8_t *bit, int side, int number, int id)
{
    try {
        cv::Ptr<cv::aruco::Dictionary> d = cv::aruco::getPredefinedDictionary(number);
        if (d->markerSize != side || id < 0 || id >= d->bytesList.rows) return false;
        cv::Mat bits = cv::aruco::Dictionary::getBitsFromByteList(d->bytesList.rowRange(id, id + 1), side);
        for (int y = 0; y < side; y++)
            for (int x = 0; x < side; x++) bit[y * side + x] = bits.at<uint8_t>(y, x);
        return true;
    } catch (...) {
        return false;
    }
}
