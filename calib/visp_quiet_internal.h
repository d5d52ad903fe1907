// ViSP tells standard output of its work, by std::cout here and by printf there, where a program may be
// writing its result.
#ifndef TELEDIMOS_CALIB_VISP_QUIET_INTERNAL_H
#define TELEDIMOS_CALIB_VISP_QUIET_INTERNAL_H

#include <cstdio>
#include <iostream>
#include <mutex>

// Silences both while it lives; one at a time, whatever the function of ViSP. glibc's stdout is a variable
// that may be set. What other threads print meanwhile is lost too: programs print before and after.
class VispQuiet {
  public:
    VispQuiet() : lock_(mutex()), buffer_(std::cout.rdbuf(nullptr)), file_(stdout)
    {
        if (nowhere()) stdout = nowhere();
    }
    ~VispQuiet()
    {
        stdout = file_;
        std::cout.rdbuf(buffer_);
    }
    VispQuiet(const VispQuiet &) = delete;
    VispQuiet &operator=(const VispQuiet &) = delete;

  private:
    static std::mutex &mutex()
    {
        static std::mutex one;
        return one;
    }
    // Never closed: another thread may still be writing to it.
    static std::FILE *nowhere()
    {
        static std::FILE *const one = std::fopen("/dev/null", "we");
        return one;
    }
    std::lock_guard<std::mutex> lock_;
    std::streambuf *buffer_;
    std::FILE *file_;
};

#endif
