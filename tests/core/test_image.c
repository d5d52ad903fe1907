/* Proves that images are read as their formats say, and that nothing else is ever returned.
 *
 * References: PNG files of every kind are put together here, byte by byte, with a writer that shares nothing
 * with libpng (stored deflate blocks, Adam7 by its table), so that each pixel is known; JPEG pixels are those
 * of OpenCV 4.6's imdecode, to the bit; PGM and PPM are written out by hand. Round trips of the lossless
 * formats are exact; JPEG of a smooth image at quality 95 is within 3 grey levels, its quantisation. Bad
 * files are made here too, each with the words that its sentence must hold. Blind to damage that leaves a
 * JPEG's Huffman stream decodable: the format has no checksum. */
#include <fcntl.h>
#include <stdio.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <jpeglib.h>

#include "core/file.h"
#include "core/image.h"
#include "core/random.h"
#include "tests/check.h"
#include "tests/scratch.h"

#if defined(__SANITIZE_ADDRESS__)
#define UNDER_ASAN 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define UNDER_ASAN 1
#endif
#endif
#ifndef UNDER_ASAN
#define UNDER_ASAN 0
#endif

static const char NAME[] = "the-file";

/* ---- A PNG writer of our own ---- */

typedef struct buffer {
    uint8_t bytes[16384];
    size_t size;
} buffer;

static void put(buffer *b, const void *bytes, size_t size)
{
    assert_true(b->size + size <= sizeof b->bytes);
    memcpy(b->bytes + b->size, bytes, size);
    b->size += size;
}

static void put_u32(buffer *b, uint32_t v)
{
    put(b, (uint8_t[]){(uint8_t)(v >> 24), (uint8_t)(v >> 16), (uint8_t)(v >> 8), (uint8_t)v}, 4);
}

static void put_chunk(buffer *b, const char *type, const void *bytes, size_t size)
{
    put_u32(b, (uint32_t)size);
    size_t begin = b->size;
    put(b, type, 4);
    put(b, bytes, size);
    uint32_t crc = 0xffffffff;
    for (size_t i = begin; i < b->size; i++) {
        crc ^= b->bytes[i];
        for (int k = 0; k < 8; k++) crc = crc >> 1 ^ (crc & 1 ? 0xedb88320 : 0);
    }
    put_u32(b, ~crc);
}

typedef struct png_kind {
    int depth, colour; /* as in IHDR */
    int interlaced;
} png_kind;

static void put_png_start(buffer *b, uint32_t width, uint32_t height, png_kind kind)
{
    buffer header = {.size = 0};
    b->size = 0;
    put(b, "\x89PNG\r\n\x1a\n", 8);
    put_u32(&header, width);
    put_u32(&header, height);
    put(&header, (uint8_t[]){(uint8_t)kind.depth, (uint8_t)kind.colour, 0, 0, (uint8_t)kind.interlaced}, 5);
    put_chunk(b, "IHDR", header.bytes, header.size);
}

static void put_png_end(buffer *b, const buffer *raw)
{
    buffer packed = {.size = 0};
    uint32_t low = 1, high = 0;
    for (size_t i = 0; i < raw->size; i++) {
        low = (low + raw->bytes[i]) % 65521;
        high = (high + low) % 65521;
    }
    put(&packed, "\x78\x01\x01", 3);
    put(&packed,
        (uint8_t[]){(uint8_t)raw->size, (uint8_t)(raw->size >> 8), (uint8_t)~raw->size,
                    (uint8_t)(~raw->size >> 8)},
        4);
    put(&packed, raw->bytes, raw->size);
    put_u32(&packed, high << 16 | low);
    put_chunk(b, "IDAT", packed.bytes, packed.size);
    put_chunk(b, "IEND", "", 0);
}

static int samples_of(int colour)
{
    return colour == 2 ? 3 : colour == 4 ? 2 : colour == 6 ? 4 : 1;
}

/* The sample of pixel (x, y), channel c, in the file's depth. */
static uint32_t sample_at(uint32_t x, uint32_t y, int c, int depth)
{
    uint32_t v = (x * 7919 + y * 104729 + (uint32_t)c * 611953 + 12345) * 2654435761u;
    return v >> (32 - depth);
}

/* Rows of every second, fourth … pixel, filter 0, bits packed from the high end. */
static void put_pass(buffer *raw, uint32_t width, uint32_t height, png_kind kind, const uint32_t step[4])
{
    for (uint32_t y = step[1]; y < height; y += step[3]) {
        if (step[0] >= width) return;
        uint32_t bits = 0, held = 0;
        put(raw, "", 1);
        for (uint32_t x = step[0]; x < width; x += step[2])
            for (int c = 0; c < samples_of(kind.colour); c++) {
                bits = bits << kind.depth | sample_at(x, y, c, kind.depth);
                for (held += (uint32_t)kind.depth; held >= 8; held -= 8)
                    put(raw, (uint8_t[]){(uint8_t)(bits >> (held - 8))}, 1);
            }
        if (held) put(raw, (uint8_t[]){(uint8_t)(bits << (8 - held))}, 1);
    }
}

static void put_png(buffer *b, uint32_t width, uint32_t height, png_kind kind)
{
    static const uint32_t adam7[7][4] = {{0, 0, 8, 8}, {4, 0, 8, 8}, {0, 4, 4, 8}, {2, 0, 4, 4},
                                         {0, 2, 2, 4}, {1, 0, 2, 2}, {0, 1, 1, 2}};
    static const uint32_t plain[4] = {0, 0, 1, 1};
    buffer raw = {.size = 0};
    put_png_start(b, width, height, kind);
    if (kind.colour == 3) {
        uint8_t palette[256][3], opacity[4] = {0, 100, 200, 255};
        for (int i = 0; i < 1 << kind.depth; i++)
            for (int c = 0; c < 3; c++) palette[i][c] = (uint8_t)(i * 31 + c * 85 + 3);
        put_chunk(b, "PLTE", palette, (size_t)3 << kind.depth);
        put_chunk(b, "tRNS", opacity, kind.depth == 1 ? 2 : 4);
    }
    if (kind.colour == 0 && kind.depth == 8) put_chunk(b, "tRNS", "\0\x21", 2);
    if (!kind.interlaced) put_pass(&raw, width, height, kind, plain);
    for (int pass = 0; kind.interlaced && pass < 7; pass++) put_pass(&raw, width, height, kind, adam7[pass]);
    put_png_end(b, &raw);
}

/* What the pixel is in 8 bits, red, green, blue. */
static void expect_rgb(int rgb[3], uint32_t x, uint32_t y, png_kind kind)
{
    int most = (1 << kind.depth) - 1;
    for (int c = 0; c < 3; c++) {
        int v = (int)sample_at(x, y, kind.colour == 2 || kind.colour == 6 ? c : 0, kind.depth);
        rgb[c] = kind.colour == 3 ? (uint8_t)(v * 31 + c * 85 + 3) : (int)floor(v * 255. / most + 0.5);
    }
}

static double luma(const int rgb[3])
{
    return 0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2];
}

static void test_every_kind_of_png(void **state)
{
    (void)state;
    static const png_kind kinds[] = {
        {1, 0, 0},  {2, 0, 0}, {4, 0, 0}, {8, 0, 0}, {16, 0, 0}, {8, 2, 0},  {16, 2, 0},
        {1, 3, 0},  {2, 3, 0}, {4, 3, 0}, {8, 3, 0}, {8, 4, 0},  {16, 4, 0}, {8, 6, 0},
        {16, 6, 0}, {8, 0, 1}, {1, 0, 1}, {8, 2, 1}, {16, 6, 1}, {4, 3, 1},
    };
    enum { WIDTH = 21, HEIGHT = 13 };
    for (size_t k = 0; k < sizeof kinds / sizeof *kinds; k++) {
        buffer file;
        td_error error = {0};
        td_image *grey, *colour;
        put_png(&file, WIDTH, HEIGHT, kinds[k]);
        check_ok(td_image_decode(&grey, file.bytes, file.size, 1, NAME, &error), error);
        check_ok(td_image_decode(&colour, file.bytes, file.size, 3, NAME, &error), error);
        assert_int_equal(grey->width * 1000 + grey->height, WIDTH * 1000 + HEIGHT);
        assert_int_equal(grey->channels, 1);
        assert_int_equal(colour->channels, 3);
        for (uint32_t y = 0; y < HEIGHT; y++)
            for (uint32_t x = 0; x < WIDTH; x++) {
                int rgb[3];
                expect_rgb(rgb, x, y, kinds[k]);
                for (int c = 0; c < 3; c++)
                    assert_int_equal(colour->data[3 * (y * WIDTH + x) + (uint32_t)c], rgb[c]);
                check_near(grey->data[y * WIDTH + x], luma(rgb), 0.502);
            }
        td_image_free(&grey);
        td_image_free(&colour);
        assert_null(grey);
    }
}

/* ---- JPEG against OpenCV ---- */

/* 16 x 12, quality 60, from cv2.imencode of b = 13x + 3y, g = 255 - 17y, r = 2xy (mod 256);
 * python3-opencv 4.6.0. */
static const char BASELINE[] =
    "ffd8ffe000104a46494600010100000100010000ffdb0043000d090a0b0a080d0b0a0b0e0e0d0f13201513121213271c1e17"
    "202e2931302e292d2c333a4a3e333646372c2d405741464c4e525352323e5a615a50604a51524fffdb0043010e0e0e131113"
    "261515264f352d354f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f"
    "4f4f4f4f4f4f4f4fffc0001108000c001003012200021101031101ffc4001f00000105010101010101000000000000000001"
    "02030405060708090a0bffc400b5100002010303020403050504040000017d01020300041105122131410613516107227114"
    "328191a1082342b1c11552d1f02433627282090a161718191a25262728292a3435363738393a434445464748494a53545556"
    "5758595a636465666768696a737475767778797a838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5"
    "b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9eaf1f2f3f4f5f6f7f8f9faffc4001f010003"
    "0101010101010101010000000000000102030405060708090a0bffc400b51100020102040403040705040400010277000102"
    "031104052131061241510761711322328108144291a1b1c109233352f0156272d10a162434e125f11718191a262728292a35"
    "363738393a434445464748494a535455565758595a636465666768696a737475767778797a82838485868788898a92939495"
    "969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae2e3e4e5e6e7e8e9ea"
    "f2f3f4f5f6f7f8f9faffda000c03010002110311003f0020bedd8e6b4a0977e2b8eb095ce326b52e6ee78122589f6efce48e"
    "bdbfc6960706b99451e750ca28fb27527b23ffd9";
/* The same, with IMWRITE_JPEG_PROGRESSIVE. */
static const char PROGRESSIVE[] =
    "ffd8ffe000104a46494600010100000100010000ffdb0043000d090a0b0a080d0b0a0b0e0e0d0f13201513121213271c1e17"
    "202e2931302e292d2c333a4a3e333646372c2d405741464c4e525352323e5a615a50604a51524fffdb0043010e0e0e131113"
    "261515264f352d354f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f4f"
    "4f4f4f4f4f4f4f4fffc2001108000c001003012200021101031101ffc4001600010101000000000000000000000000000400"
    "05ffc4001501010100000000000000000000000000000104ffda000c03010002100310000001938ca26fffc4001610010101"
    "00000000000000000000000000010002ffda0008010100010502370d86d692ffc40018110002030000000000000000000000"
    "00000212000104ffda0008010301013f010c80ad73ffc40017110100030000000000000000000000000003001121ffda0008"
    "010201013f0101da9fffc40017100003010000000000000000000000000000011011ffda0008010100063f02ab0fffc40016"
    "1000030000000000000000000000000000000111ffda0008010100013f21b961c274694fffda000c03010002000300000010"
    "3fffc40017110003010000000000000000000000000000011131ffda0008010301013f10bb8a3fffc4001611010101000000"
    "00000000000000000000010011ffda0008010201013f100c0bffc4001a100002030101000000000000000000000000011121"
    "3141d1ffda0008010100013f10a96571f8966fed96b79e9fffd9";
/* FNV-1a over cv2.imdecode's pixels, grey, and colour turned to RGB. */
static const uint64_t GREY_HASH = 0x859a6ef7fa0035aa, COLOUR_HASH = 0x197639a5c41bd992;

static void put_hex(buffer *b, const char *hex)
{
    b->size = 0;
    for (; *hex; hex += 2) {
        char pair[3] = {hex[0], hex[1], 0};
        put(b, (uint8_t[]){(uint8_t)strtoul(pair, NULL, 16)}, 1);
    }
}

static uint64_t hash_of(const td_image *image)
{
    uint64_t hash = 0xcbf29ce484222325;
    for (int i = 0; i < image->width * image->height * image->channels; i++)
        hash = (hash ^ image->data[i]) * 0x100000001b3;
    return hash;
}

static void test_jpeg_is_opencvs(void **state)
{
    (void)state;
    const char *files[] = {BASELINE, PROGRESSIVE};
    for (int i = 0; i < 2; i++) {
        buffer file;
        td_error error = {0};
        td_image *grey, *colour;
        put_hex(&file, files[i]);
        /* Whatever a camera hangs behind the image does not matter. */
        if (i == 1) put(&file, "maker's notes", 13);
        check_ok(td_image_decode(&grey, file.bytes, file.size, 1, NAME, &error), error);
        check_ok(td_image_decode(&colour, file.bytes, file.size, 3, NAME, &error), error);
        assert_int_equal(grey->width * 1000 + grey->height, 16012);
        assert_int_equal(grey->data[5 * 16 + 7], 132);
        assert_true(hash_of(grey) == GREY_HASH);
        assert_true(hash_of(colour) == COLOUR_HASH);
        td_image_free(&grey);
        td_image_free(&colour);
    }
}

/* ---- Round trips ---- */

static td_image *make_image(int width, int height, int channels, int noise)
{
    td_image *image = NULL;
    td_error error = {0};
    td_random random = td_random_seed(1, 1);
    check_ok(td_image_new(&image, width, height, channels, &error), error);
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++)
            for (int c = 0; c < channels; c++)
                image->data[(y * width + x) * channels + c] =
                    noise ? (uint8_t)td_random_u32(&random)
                          : (uint8_t)(127 + 60 * sin(0.05 * x + 0.3) + 60 * cos(0.04 * y + 0.2 * c));
    return image;
}

static void test_round_trips(void **state)
{
    const char *names[] = {"a.png", "a.PNG", "a.pgm", "a.ppm", "a.jpg", "a.JPEG"};
    td_error error = {0};
    for (size_t n = 0; n < sizeof names / sizeof *names; n++)
        for (int channels = 1; channels <= 3; channels += 2) {
            int lossy = n >= 4;
            char *path = td_path_join(*state, names[n]);
            td_image *image = make_image(301, 217, channels, !lossy), *back;
            if (n == (channels == 1 ? 3 : 2)) {
                check_fails(td_image_write(path, image, &error), TD_ERROR_ARGUMENT, error, "must end in");
            } else {
                check_ok(td_image_write(path, image, &error), error);
                check_ok(td_image_read(&back, path, channels, &error), error);
                assert_int_equal(back->width * 1000 + back->height, 301217);
                int largest = 0;
                for (int i = 0; i < 301 * 217 * channels; i++) {
                    int apart = abs(back->data[i] - image->data[i]);
                    if (apart > largest) largest = apart;
                }
                assert_in_range(largest, 0, lossy ? 3 : 0);
                td_image_free(&back);
            }
            td_image_free(&image);
            free(path);
        }
}

/* Noise at quality 100 is larger than the encoder's first piece of memory, so the memory grows under it. */
static void test_encode_large(void **state)
{
    (void)state;
    td_error error = {0};
    td_image *image = make_image(700, 500, 3, 1), *back;
    uint8_t *bytes;
    size_t size;
    check_ok(td_image_encode_jpeg(&bytes, &size, image, 100, &error), error);
    assert_true(size > 300000);
    check_ok(td_image_decode(&back, bytes, size, 3, NAME, &error), error);
    double sum = 0;
    for (int i = 0; i < 700 * 500; i++) sum += abs(back->data[3 * i + 1] - image->data[3 * i + 1]);
    check_less(sum / (700 * 500), 40); /* chroma is halved; noise apart from itself would give 85 */
    td_image_free(&back);
    free(bytes);
    bytes = (uint8_t *)1;
    for (int quality = -1; quality <= 101; quality += 102) {
        check_fails(td_image_encode_jpeg(&bytes, &size, image, quality == -1 ? 0 : quality, &error),
                    TD_ERROR_ARGUMENT, error, "quality");
        assert_null(bytes);
    }
    td_image_free(&image);
}

/* ---- Binary PGM and PPM ---- */

static void check_pnm(const char *bytes, size_t size, int width, int height, const uint8_t *grey)
{
    td_error error = {0};
    td_image *image;
    check_ok(td_image_decode(&image, bytes, size, 1, NAME, &error), error);
    assert_int_equal(image->width, width);
    assert_int_equal(image->height, height);
    assert_memory_equal(image->data, grey, (size_t)(width * height));
    td_image_free(&image);
}

#define CHECK_PNM(text, width, height, ...)                                                                  \
    check_pnm(text, sizeof text - 1, width, height, (const uint8_t[]){__VA_ARGS__})

static void test_pnm(void **state)
{
    (void)state;
    CHECK_PNM("P5\n2 1\n255\n\x01\xff", 2, 1, 1, 255);
    CHECK_PNM("P5# a comment\n# another, 7 8\n2 # width\r1\t\v255 # 255", 2, 1, '#', ' ');
    CHECK_PNM("P5 2 1 255\n\n\n", 2, 1, '\n', '\n');
    CHECK_PNM("P5 4 1 100\n\x00\x32\x63\x64", 4, 1, 0, 128, 252, 255);
    CHECK_PNM("P5 3 1 65535\n\x00\x00\x80\x00\xff\xff", 3, 1, 0, 128, 255);
    CHECK_PNM("P5 2 1 1023\n\x02\x00\x03\xff", 2, 1, 128, 255);
    CHECK_PNM("P5 1 1 1\n\x01", 1, 1, 255);
    CHECK_PNM("P6 2 1 255\n\xff\x00\x00\x10\x20\x30", 2, 1, 76, 29);
    CHECK_PNM("P5 1 1 255\n\x07P5 1 1 255\n\x08", 1, 1, 7); /* the first of several */
}

/* ---- Bad input ---- */

static void check_refused(const void *bytes, size_t size, const char *words)
{
    td_error error = {0};
    td_image *image = (td_image *)1;
    check_fails(td_image_decode(&image, bytes, size, 1, NAME, &error), TD_ERROR_FORMAT, error, words);
    assert_null(image);
    assert_true(strncmp(error.message, "the-file: ", 10) == 0);
    for (const char *c = error.message; *c; c++) assert_in_range(*c, ' ', '~');
}

#define CHECK_REFUSED(text, words) check_refused(text, sizeof text - 1, words)

static void test_foreign_files(void **state)
{
    (void)state;
    CHECK_REFUSED("", "is empty (0 bytes)");
    CHECK_REFUSED("Dear \"sir\",\nthe image is", "not an image (starts with text \"Dear 'sir',\")");
    CHECK_REFUSED("<html><body>404 Not Found", "starts with text \"<html><body>404 Not Found\"");
    CHECK_REFUSED("version https://git-lfs.github.com/spec/v1\noid",
                  "not an image (starts with text \"version https");
    CHECK_REFUSED("text\033[31m", "starts with text \"text\"");
    CHECK_REFUSED("P", "starts with text \"P\"");
    CHECK_REFUSED("\x01\x02\xfe\x00zzzzzzz", "starts with bytes 01 02 fe 00 7a 7a 7a 7a)");
    CHECK_REFUSED("\xc3\xa4", "starts with bytes c3 a4)");
    CHECK_REFUSED("II*\0\x08\0\0\0", "is a TIFF image; convert it to PNG, JPEG or binary PGM");
    CHECK_REFUSED("MM\0*\0\0\0\x08", "is a TIFF image");
    CHECK_REFUSED("II+\0\x08\0\0\0", "is a TIFF image");
    CHECK_REFUSED("BM\x46\0\0\0\0\0\0\0\x36\0\0\0", "is a BMP image");
    CHECK_REFUSED("BMW: 320i", "starts with text \"BMW: 320i\"");
    CHECK_REFUSED("GIF89a", "is a GIF image");
    CHECK_REFUSED("RIFF\x10\0\0\0WEBPVP8 ", "is a WebP image");
    CHECK_REFUSED("RIFF\x10\0\0\0WAVEfmt ", "starts with text \"RIFF\"");
    CHECK_REFUSED("%PDF-1.4\n", "is a PDF document");
    CHECK_REFUSED("\0\0\0\x0cjP  \r\n\x87\n", "is a JPEG 2000 image");
    CHECK_REFUSED("\0\0\0\x18"
                  "ftypheic",
                  "is a HEIF image or MP4 film");
    CHECK_REFUSED("P2\n1 1\n255\n7\n", "is a PGM image in text form");
    CHECK_REFUSED("P3\n1 1\n255\n7 7 7\n", "is a PPM image in text form");
    CHECK_REFUSED("P4\n8 1\n\x01", "is a PBM image");
    CHECK_REFUSED("P7\nWIDTH 1\n", "is a PAM image");
}

static void test_bad_pnm(void **state)
{
    (void)state;
    CHECK_REFUSED("P5", "end within the header");
    CHECK_REFUSED("P5 # no end of this comment", "end within the header");
    CHECK_REFUSED("P5 2 2 255", "end within the header");
    CHECK_REFUSED("P5 2 2 255\n123", "is truncated: 2 x 2 pixels need 4 bytes, and 3 are there");
    CHECK_REFUSED("P6 2 2 65535\n12345678901234567890123", "need 24 bytes, and 23 are there");
    CHECK_REFUSED("P5 -2 2 255\n1234", "its width is not a number");
    CHECK_REFUSED("P5 2 x 255\n1234", "its height is not a number");
    CHECK_REFUSED("P5 2 2 25a\n1234", "its largest value is not a number");
    CHECK_REFUSED("P5 0 2 255\n1234", "it has none");
    CHECK_REFUSED("P5 2 0 255\n1234", "it has none");
    CHECK_REFUSED("P5 2 2 0\n1234", "its largest value is not 1 to 65535");
    CHECK_REFUSED("P5 2 2 65536\n12345678", "its largest value is not 1 to 65535");
    CHECK_REFUSED("P5 2 1 100\n\x64\x65", "holds the value 101, and its header allows 100");
    CHECK_REFUSED("P5 65536 1 255\n1", "claims 65536 x 1 pixels, more than the limit");
    CHECK_REFUSED("P5 1 65536 255\n1", "more than the limit");
    CHECK_REFUSED("P5 65535 65535 255\n1", "more than the limit");
    CHECK_REFUSED("P5 99999999999999999999999999 18446744073709551617 255\n1", "more than the limit");
}

static void test_bad_png(void **state)
{
    (void)state;
    const png_kind plain = {8, 0, 0};
    buffer file, raw = {.size = 0};
    put_png_start(&file, 0, 3, plain);
    check_refused(file.bytes, file.size, "is a damaged PNG");
    put_png_start(&file, 2000000000, 2000000000, plain);
    put_png_end(&file, &raw);
    check_refused(file.bytes, file.size, "claims 2000000000 x 2000000000 pixels, more than the limit");
    put_png_start(&file, 65535, 65535, plain);
    put_png_end(&file, &raw);
    check_refused(file.bytes, file.size, "more than the limit");
    put_png_start(&file, 4, 4, plain);
    put_png_end(&file, &raw);
    check_refused(file.bytes, file.size, "is a damaged PNG");
    put_png_start(&file, 4, 4, (png_kind){8, 5, 0}); /* no such colour */
    put_png_end(&file, &raw);
    check_refused(file.bytes, file.size, "is a damaged PNG");
    put_png_start(&file, 4, 4, (png_kind){8, 3, 0}); /* no palette */
    put_png_end(&file, &raw);
    check_refused(file.bytes, file.size, "is a damaged PNG");
    put_png(&file, 5, 5, plain);
    file.bytes[5] = '\r'; /* as a transfer as text makes of \r\n */
    check_refused(file.bytes, file.size, "is a damaged PNG (PNG file corrupted by ASCII conversion)");
}

/* A JPEG of 16 x 16 pixels in this colour space, as libjpeg writes it. */
static void put_jpeg(buffer *b, J_COLOR_SPACE space, int components, int arithmetic, int progressive)
{
    const jpeg_scan_info scans[] = {{1, {0}, 0, 0, 0, 0}, {1, {0}, 1, 63, 0, 0}};
    struct jpeg_error_mgr manager;
    struct jpeg_compress_struct out = {.err = jpeg_std_error(&manager)};
    unsigned char *bytes = NULL, line[64];
    unsigned long size = 0;
    jpeg_create_compress(&out);
    jpeg_mem_dest(&out, &bytes, &size);
    out.image_width = out.image_height = 16;
    out.input_components = components;
    out.in_color_space = space;
    jpeg_set_defaults(&out);
    out.arith_code = arithmetic;
    if (progressive) {
        out.scan_info = scans;
        out.num_scans = 2;
    }
    jpeg_start_compress(&out, TRUE);
    memset(line, 99, sizeof line);
    for (int y = 0; y < 16; y++) {
        JSAMPROW row = line;
        jpeg_write_scanlines(&out, &row, 1);
    }
    jpeg_finish_compress(&out);
    jpeg_destroy_compress(&out);
    b->size = 0;
    put(b, bytes, size);
    free(bytes);
}

static size_t find_marker(const buffer *b, int marker)
{
    for (size_t i = 0; i + 1 < b->size; i++)
        if (b->bytes[i] == 0xff && b->bytes[i + 1] == marker) return i;
    fail_msg("no marker %x", (unsigned)marker);
    return 0;
}

static void test_bad_jpeg(void **state)
{
    (void)state;
    buffer file, whole;
    put_jpeg(&file, JCS_CMYK, 4, 0, 0);
    check_refused(file.bytes, file.size, "inks of a printer");
    put_jpeg(&file, JCS_GRAYSCALE, 1, 1, 0);
    check_refused(file.bytes, file.size, "arithmetic coding");
    put_hex(&whole, BASELINE);
    size_t frame = find_marker(&whole, 0xc0), scan = find_marker(&whole, 0xda);
    file = whole;
    file.bytes[frame + 4] = 12; /* bits a sample */
    check_refused(file.bytes, file.size, "is a damaged JPEG (Unsupported JPEG data precision 12)");
    file = whole;
    memset(file.bytes + frame + 5, 0xff, 4); /* height and width */
    check_refused(file.bytes, file.size,
                  "is a damaged JPEG (Maximum supported image dimension is 65500 pixels)");
    file = whole;
    memcpy(file.bytes + frame + 5, "\xff\x00\xff\x00", 4);
    check_refused(file.bytes, file.size, "claims 65280 x 65280 pixels, more than the limit");
    file = whole;
    memcpy(file.bytes + frame + 5, "\0\0", 2);
    check_refused(file.bytes, file.size, "is a damaged JPEG");
    /* The end marker comes too early: libjpeg would only warn, and fill the rest in grey. */
    file = whole;
    file.size = scan + 20;
    put(&file, "\xff\xd9", 2);
    check_refused(file.bytes, file.size, "is a damaged JPEG (its image data end before the last row)");
    /* A few bytes behind the scan are some camera's padding; many are not. */
    file = whole;
    file.size -= 2;
    put(&file, "\x11\x22\x33\xff\xd9", 5);
    td_image *image;
    td_error error = {0};
    check_ok(td_image_decode(&image, file.bytes, file.size, 1, NAME, &error), error);
    assert_true(hash_of(image) == GREY_HASH);
    td_image_free(&image);
    file.size -= 2;
    for (int i = 0; i < 40; i++) put(&file, "\x11", 1);
    put(&file, "\xff\xd9", 2);
    check_refused(file.bytes, file.size, "is a damaged JPEG");
}

/* Scans without end, each a pass over the image: the last one of a progressive JPEG again and again. */
static void test_jpeg_of_many_scans(void **state)
{
    (void)state;
    buffer file, whole;
    td_error error = {0};
    td_image *image;
    put_jpeg(&whole, JCS_GRAYSCALE, 1, 0, 1);
    size_t scan = whole.size - 2;
    while (whole.bytes[scan] != 0xff || whole.bytes[scan + 1] != 0xda) scan--;
    for (int scans = 100; scans <= 600; scans += 500) {
        file = whole;
        file.size -= 2;
        for (int i = 0; i < scans; i++) put(&file, whole.bytes + scan, whole.size - 2 - scan);
        put(&file, "\xff\xd9", 2);
        if (scans == 600) {
            check_refused(file.bytes, file.size, "more scans than any image has");
        } else {
            check_ok(td_image_decode(&image, file.bytes, file.size, 1, NAME, &error), error);
            assert_int_equal(image->data[100], 99);
            td_image_free(&image);
        }
    }
}

/* A short file that claims a giant image fails before the image is allocated: here, with room for far less.
 */
static void test_short_files_of_giant_images(void **state)
{
    (void)state;
    struct rlimit old, low;
    buffer png, jpeg[2], raw = {.size = 0};
    put_png_start(&png, 20000, 19999, (png_kind){16, 6, 0});
    put_png_end(&png, &raw);
    put_hex(&jpeg[0], BASELINE);
    put_hex(&jpeg[1], PROGRESSIVE);
    memcpy(jpeg[0].bytes + find_marker(&jpeg[0], 0xc0) + 5, "\x4e\x20\x4e\x1f", 4);
    memcpy(jpeg[1].bytes + find_marker(&jpeg[1], 0xc2) + 5, "\x4e\x20\x4e\x1f", 4);

    assert_int_equal(getrlimit(RLIMIT_AS, &old), 0);
    low = old;
    low.rlim_cur = (rlim_t)256 << 20;
    if (!UNDER_ASAN) assert_int_equal(setrlimit(RLIMIT_AS, &low), 0);
    td_status status[4];
    td_error error[4] = {{0}};
    td_image *image;
    status[0] = td_image_decode(&image, png.bytes, png.size, 1, NAME, &error[0]);
    for (int i = 0; i < 2; i++)
        status[1 + i] = td_image_decode(&image, jpeg[i].bytes, jpeg[i].size, 1, NAME, &error[1 + i]);
    status[3] = td_image_decode(&image, "P5 20000 19999 255\nx", 20, 1, NAME, &error[3]);
    assert_int_equal(setrlimit(RLIMIT_AS, &old), 0);
    for (int i = 0; i < 3; i++) check_fails(status[i], TD_ERROR_FORMAT, error[i], "bytes cannot hold the ");
    check_fails(status[3], TD_ERROR_FORMAT, error[3], "is truncated");
}

static void write_bytes(const char *path, const void *bytes, size_t size)
{
    td_error error = {0};
    check_ok(td_file_write(path, bytes, size, &error), error);
}

static void test_files_by_path(void **state)
{
    td_error error = {0};
    td_image *image = (td_image *)1;
    buffer png;
    char *absent = td_path_join(*state, "absent.png"), *text = td_path_join(*state, "notes.png"),
         *empty = td_path_join(*state, "empty.jpg"), *odd = td_path_join(*state, "right.txt");
    check_fails(td_image_read(&image, absent, 1, &error), TD_ERROR_IO, error, "absent.png");
    assert_null(image);
    check_fails(td_image_read(&image, *state, 1, &error), TD_ERROR_IO, error, "folder");
    write_bytes(text, "Hello", 5);
    check_fails(td_image_read(&image, text, 1, &error), TD_ERROR_FORMAT, error,
                "notes.png: is not an image (starts with text \"Hello\")");
    write_bytes(empty, "", 0);
    check_fails(td_image_read(&image, empty, 1, &error), TD_ERROR_FORMAT, error,
                "empty.jpg: is empty (0 bytes)");
    put_png(&png, 9, 7, (png_kind){8, 0, 0});
    write_bytes(odd, png.bytes, png.size);
    check_fails(td_image_read(&image, odd, 2, &error), TD_ERROR_ARGUMENT, error, "right.txt");
    check_ok(td_image_read(&image, odd, 1, &error), error); /* told by content, not by name */
    check_fails(td_image_write(odd, image, &error), TD_ERROR_ARGUMENT, error,
                "must end in .png, .jpg or .pgm");
    char *nowhere = td_path_join(*state, "no-such-folder/a.png");
    check_fails(td_image_write(nowhere, image, &error), TD_ERROR_IO, error, "no-such-folder");
    td_image_free(&image);
    free(absent);
    free(text);
    free(empty);
    free(odd);
    free(nowhere);
}

/* ---- Damage, exhaustively ---- */

/* Decodes; true when it fails as it should: no image and a sentence that names the file. */
static int decode_fails(const void *bytes, size_t size, int channels, int *wrong)
{
    td_error error = {0};
    td_image *image = (td_image *)1;
    td_status status = td_image_decode(&image, bytes, size, channels, NAME, &error);
    if (status == TD_OK) {
        *wrong += image->channels != channels;
        td_image_free(&image);
        return 0;
    }
    *wrong += image != NULL || error.status != status || strncmp(error.message, "the-file: ", 10) != 0;
    return 1;
}

/* Prefixes and single flipped bits of a file: how many of each were not refused. Bytes are copied to memory
 * of their exact size, so that a sanitizer sees a step beyond them. */
static void damage(const buffer *file, size_t *prefixes, size_t *flips, int *wrong)
{
    for (size_t size = 0; size < file->size; size++) {
        uint8_t *part = malloc(size + 1);
        memcpy(part + 1, file->bytes, size);
        *prefixes += !decode_fails(part + 1, size, size % 2 ? 1 : 3, wrong);
        free(part);
    }
    uint8_t *copy = malloc(file->size);
    memcpy(copy, file->bytes, file->size);
    for (size_t bit = 0; bit < 8 * file->size; bit++) {
        copy[bit / 8] ^= (uint8_t)(1 << bit % 8);
        *flips += !decode_fails(copy, file->size, bit % 2 ? 1 : 3, wrong);
        copy[bit / 8] ^= (uint8_t)(1 << bit % 8);
    }
    free(copy);
}

static void test_every_prefix_and_bit(void **state)
{
    char *path = td_path_join(*state, "stderr.txt");
    buffer png[3], jpeg[2], pnm = {.size = 0};
    size_t png_prefixes = 0, png_flips = 0, jpeg_prefixes = 0, jpeg_flips = 0, pnm_prefixes = 0,
           pnm_flips = 0;
    int wrong = 0;
    put_png(&png[0], 9, 7, (png_kind){8, 2, 0});
    put_png(&png[1], 9, 7, (png_kind){16, 0, 1});
    put_png(&png[2], 9, 7, (png_kind){16, 6, 0});
    put_hex(&jpeg[0], BASELINE);
    put_hex(&jpeg[1], PROGRESSIVE);
    put(&pnm, "P6 # c\n3 2 255\n123456789012345678", 33);

    /* The libraries' own complaints must not reach the terminal. */
    fflush(stderr);
    int saved = dup(2), to = open(path, O_WRONLY | O_CREAT, 0600);
    assert_true(saved >= 0 && to >= 0);
    dup2(to, 2);
    for (int i = 0; i < 3; i++) damage(&png[i], &png_prefixes, &png_flips, &wrong);
    for (int i = 0; i < 2; i++) damage(&jpeg[i], &jpeg_prefixes, &jpeg_flips, &wrong);
    damage(&pnm, &pnm_prefixes, &pnm_flips, &wrong);
    fflush(stderr);
    dup2(saved, 2);
    close(saved);
    close(to);
    struct stat printed;
    assert_int_equal(stat(path, &printed), 0);
    assert_int_equal(printed.st_size, 0);

    assert_int_equal(wrong, 0);
    assert_int_equal(png_prefixes, 0);
    assert_int_equal(jpeg_prefixes, 0);
    assert_int_equal(pnm_prefixes, 0);
    assert_int_equal(png_flips, 0); /* every byte stands under a checksum */
    /* These have none, so that some flips must pass: else the decoder refuses everything. */
    assert_true(jpeg_flips > 100 && jpeg_flips < 8 * (jpeg[0].size + jpeg[1].size));
    assert_true(pnm_flips > 100 && pnm_flips < 8 * pnm.size);
    free(path);
}

/* ---- In memory ---- */

static void test_new(void **state)
{
    (void)state;
    const int bad[][3] = {{0, 1, 1},     {1, 0, 1},         {-1, 1, 1}, {1, 1, 2},
                          {65536, 1, 1}, {65535, 65535, 1}, {1, 1, 4},  {1, INT32_MIN, 3}};
    td_error error = {0};
    td_image *image = (td_image *)1;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        check_fails(td_image_new(&image, bad[i][0], bad[i][1], bad[i][2], &error), TD_ERROR_ARGUMENT, error,
                    "an image cannot be");
        assert_null(image);
    }
    check_ok(td_image_new(&image, 3, 2, 3, &error), error);
    for (int i = 0; i < 18; i++) assert_int_equal(image->data[i], 0);
    td_image_free(&image);
    td_image_free(&image);
    td_image_free(NULL);
}

static void test_sample(void **state)
{
    (void)state;
    uint8_t data[] = {10, 1, 0, 20, 2, 0, 40, 4, 0, 110, 11, 0, 130, 13, 0, 250, 25, 0};
    const td_image image = {3, 2, 3, data}, dot = {1, 1, 1, data};
    check_near(td_image_sample(&image, 0, 0, 0), 10, 0);
    check_near(td_image_sample(&image, 2, 1, 0), 250, 0);
    check_near(td_image_sample(&image, 0.5, 0, 0), 15, 1e-12);
    check_near(td_image_sample(&image, 0, 0.25, 0), 35, 1e-12);
    check_near(td_image_sample(&image, 1.25, 0.5, 0), (0.75 * 150 + 0.25 * 290) / 2, 1e-12);
    check_near(td_image_sample(&image, 1.25, 0.5, 1), (0.75 * 15 + 0.25 * 29) / 2, 1e-12);
    check_near(td_image_sample(&image, -7, -1e300, 0), 10, 0);
    check_near(td_image_sample(&image, 1e300, 7, 1), 25, 0);
    check_near(td_image_sample(&image, 2.4, 0.5, 0), 145, 1e-12);
    check_near(td_image_sample(&image, NAN, NAN, 0), 10, 0);
    check_near(td_image_sample(&dot, 0.5, 0.5, 0), 10, 0);
}

static void test_shrink(void **state)
{
    (void)state;
    td_error error = {0};
    td_image *image = make_image(203, 101, 3, 1), *small;
    for (int times = 0; times <= 6; times++) {
        int side = 1 << times;
        check_ok(td_image_shrink(&small, image, times, &error), error);
        assert_int_equal(small->width, 203 / side);
        assert_int_equal(small->height, 101 / side);
        for (int y = 0; y < small->height; y++)
            for (int x = 0; x < small->width; x++)
                for (int c = 0; c < 3; c++) {
                    double sum = 0;
                    for (int k = 0; k < side * side; k++)
                        sum += image->data[((y * side + k / side) * 203 + x * side + k % side) * 3 + c];
                    assert_int_equal(small->data[(y * small->width + x) * 3 + c],
                                     (int)floor(sum / (side * side) + 0.5));
                }
        td_image_free(&small);
    }
    const int bad[] = {-1, 7, 16, 1000};
    for (int i = 0; i < 4; i++) {
        small = image;
        check_fails(td_image_shrink(&small, image, bad[i], &error), TD_ERROR_ARGUMENT, error,
                    "cannot be halved");
        assert_null(small);
    }
    td_image_free(&image);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_every_kind_of_png),
        cmocka_unit_test(test_jpeg_is_opencvs),
        cmocka_unit_test_setup_teardown(test_round_trips, scratch_make, scratch_remove),
        cmocka_unit_test(test_encode_large),
        cmocka_unit_test(test_pnm),
        cmocka_unit_test(test_foreign_files),
        cmocka_unit_test(test_bad_pnm),
        cmocka_unit_test(test_bad_png),
        cmocka_unit_test(test_bad_jpeg),
        cmocka_unit_test(test_jpeg_of_many_scans),
        cmocka_unit_test(test_short_files_of_giant_images),
        cmocka_unit_test_setup_teardown(test_files_by_path, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(test_every_prefix_and_bit, scratch_make, scratch_remove),
        cmocka_unit_test(test_new),
        cmocka_unit_test(test_sample),
        cmocka_unit_test(test_shrink),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
