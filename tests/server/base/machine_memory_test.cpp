// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/base/machine_memory.h"

#include <gtest/gtest.h>

#include <fstream>
#include <string>

#include "server/config.h"
#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kGiB = std::uint64_t{1} << 30;

/// A machine of 8 GiB, as its /proc and /sys tell.
class MachineMemory : public testing::Test {
 protected:
  test::TemporaryFolder root;

  void SetUp() override { write("proc/meminfo", "MemTotal:        8388608 kB\nMemFree:         1024 kB\n"); }
  void write(const std::string& file, const std::string& text) const {
    fs::create_directories((root.path() / file).parent_path());
    std::ofstream(root.path() / file) << text;
  }
  std::uint64_t found() const { return memory_there_is(root.path()); }
};

TEST_F(MachineMemory, IsTheMachinesWithoutALimit) {
  EXPECT_EQ(found(), 8 * kGiB);
  write("proc/self/cgroup", "0::/\n");
  EXPECT_EQ(found(), 8 * kGiB);
  write("sys/fs/cgroup/memory.max", "max\n");
  EXPECT_EQ(found(), 8 * kGiB);
  EXPECT_EQ(memory_there_is(root.path() / "nothing here"), 4 * kGiB);
}

// A service's limit is in its own group, not at the top of the hierarchy.
TEST_F(MachineMemory, IsLimitedByTheProcessesGroup) {
  write("proc/self/cgroup", "0::/system.slice/spherule.service\n");
  write("sys/fs/cgroup/system.slice/spherule.service/memory.max", "2147483648\n");
  EXPECT_EQ(found(), 2 * kGiB);
}

TEST_F(MachineMemory, IsLimitedByEveryGroupAbove) {
  write("proc/self/cgroup", "0::/system.slice/spherule.service\n");
  write("sys/fs/cgroup/system.slice/spherule.service/memory.max", "max\n");
  write("sys/fs/cgroup/system.slice/memory.max", "3221225472\n");
  EXPECT_EQ(found(), 3 * kGiB);
  write("sys/fs/cgroup/memory.max", "1073741824\n");
  EXPECT_EQ(found(), kGiB) << "of a container, whose groups outside it does not see";
}

TEST_F(MachineMemory, CountsWhereThrottlingBegins) {
  write("proc/self/cgroup", "0::/a\n");
  write("sys/fs/cgroup/a/memory.max", "4294967296\n");
  write("sys/fs/cgroup/a/memory.high", "3221225472\n");
  EXPECT_EQ(found(), 3 * kGiB);
}

TEST_F(MachineMemory, IsLimitedByGroupsOfVersionOne) {
  write("proc/self/cgroup", "12:cpu,cpuacct:/other\n9:memory:/docker/0123abcd\n0::/init.scope\n");
  write("sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n");
  EXPECT_EQ(found(), 8 * kGiB) << "its word for none";
  write("sys/fs/cgroup/memory/docker/0123abcd/memory.limit_in_bytes", "1073741824\n");
  EXPECT_EQ(found(), kGiB);
  write("sys/fs/cgroup/memory/other/memory.limit_in_bytes", "1\n");
  EXPECT_EQ(found(), kGiB) << "of a group that the process is not in";
}

TEST_F(MachineMemory, IsNotMisledByPathsOrNonsense) {
  write("sys/fs/cgroup/memory.max", "1073741824\n");
  write("proc/self/cgroup", "nonsense\n0::/../../elsewhere\n");
  EXPECT_EQ(found(), kGiB);
  write("sys/fs/cgroup/memory.max", "0\n");
  EXPECT_EQ(found(), 8 * kGiB);
  write("sys/fs/cgroup/memory.max", "-5 or so\n");
  EXPECT_EQ(found(), 8 * kGiB);
}

TEST_F(MachineMemory, GivesJobsThreeQuarters) {
  const CommandLine line = parse_command_line({}, [](const char*) { return nullptr; });
  EXPECT_EQ(line.config.job_memory_bytes, memory_there_is() / 4 * 3);
}

}  // namespace
}  // namespace spherule::server
