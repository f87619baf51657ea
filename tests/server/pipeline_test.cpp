// SPDX-License-Identifier: GPL-3.0-or-later
//
// What the program does within a request.
#include "server/pipeline.h"

#include <gtest/gtest.h>
#include <zlib.h>

#include <atomic>
#include <thread>

#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

using test::error_of;

constexpr std::int32_t side = 400;

// Many samples in few bytes: they take long to read, and next to nothing to send.
std::string packed_zeros() {
  const std::string plane(static_cast<std::size_t>(side) * side, '\0');
  std::string packed(1 << 20, '\0');
  z_stream stream{};
  EXPECT_EQ(deflateInit2(&stream, 1, Z_DEFLATED, 15 + 16, 8, Z_DEFAULT_STRATEGY), Z_OK);
  stream.next_out = reinterpret_cast<Bytef*>(packed.data());
  stream.avail_out = static_cast<uInt>(packed.size());
  for (int k = 0; k < side; ++k) {
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(plane.data()));
    stream.avail_in = static_cast<uInt>(plane.size());
    deflate(&stream, k + 1 < side ? Z_NO_FLUSH : Z_FINISH);
  }
  packed.resize(stream.total_out);
  deflateEnd(&stream);
  return packed;
}

class PipelineTest : public testing::Test {
 protected:
  PipelineTest() : pipeline(config(folder.path())) {}
  static Config config(const std::filesystem::path& data) {
    Config config;
    config.data = data / "data";
    config.threads = 1;
    config.job_memory_bytes = std::uint64_t{4} << 30;
    return config;
  }
  api::Stored<api::VolumeInfo> store(const api::Gone& gone) {
    auto upload = pipeline.start_upload(bytes.size());
    upload->begin_file({});
    upload->write(bytes);
    api::VolumeParameters parameters;
    parameters.raw = RawLayout{.dims = {side, side, side}};
    return pipeline.store_volume(std::move(upload), parameters, gone);
  }

  const std::string bytes = packed_zeros();
  test::TemporaryFolder folder;
  Pipeline pipeline;
};

TEST_F(PipelineTest, ReadsAVolumeForWhoWaitsForIt) {
  std::atomic<int> asked{0};
  const api::Stored<api::VolumeInfo> stored = store([&] {
    ++asked;
    return false;
  });
  EXPECT_GT(asked, 0);
  EXPECT_EQ(stored.thing.grid.dims, (std::array<std::int32_t, 3>{side, side, side}));
  EXPECT_EQ(pipeline.list(api::Collection::volumes, {}).items.size(), 1U);
}

TEST_F(PipelineTest, StopsReadingWhenTheSenderIsGone) {
  EXPECT_EQ(error_of([&] { store([] { return true; }); }), ErrorCode::cancelled);
  EXPECT_TRUE(pipeline.list(api::Collection::volumes, {}).items.empty());
}

TEST_F(PipelineTest, StopsReadingWhenTheServerStops) {
  std::atomic<bool> reads{false};
  std::jthread stops([&] {
    while (!reads) std::this_thread::yield();
    EXPECT_TRUE(pipeline.stop(std::chrono::milliseconds(0)));
  });
  EXPECT_EQ(error_of([&] {
              store([&] {
                reads = true;
                return false;
              });
            }),
            ErrorCode::busy);
}

}  // namespace
}  // namespace spherule::server
