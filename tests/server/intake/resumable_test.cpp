// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/intake/resumable.h"

#include <gtest/gtest.h>

#include <array>
#include <atomic>
#include <filesystem>
#include <fstream>
#include <thread>

#include "core/base/error.h"
#include "server/base/digest.h"
#include "server/records/replies.h"

namespace spherule::server {
namespace {

using namespace std::chrono_literals;

template <typename F>
std::optional<ErrorCode> refusal(F&& f) {
  try {
    f();
    return std::nullopt;
  } catch (const Error& error) {
    return error.code();
  }
}

class Folder : public testing::Test {
 protected:
  ~Folder() override { std::filesystem::remove_all(folder); }
  // As if nothing had happened to the files of this folder for two hours.
  void age() const {
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
      std::filesystem::last_write_time(entry.path(), std::filesystem::file_time_type::clock::now() - 2h);
    }
  }
  std::size_t files() const {
    return static_cast<std::size_t>(
        std::distance(std::filesystem::directory_iterator(folder), std::filesystem::directory_iterator()));
  }
  const std::filesystem::path folder = std::filesystem::temp_directory_path() / random_id("resumable");
};

class Resumable : public Folder {
 protected:
  static std::string all_of(const ResumableUploads& uploads, const std::string& id) {
    std::string bytes;
    uploads.read(id, [&](std::string_view piece) { bytes += piece; });
    return bytes;
  }
  static std::function<void(const ResumableUploads::TakeBytes&)> bytes(std::string text) {
    return [text = std::move(text)](const ResumableUploads::TakeBytes& take) { take(text); };
  }
};

TEST_F(Resumable, GoOnAfterABreakAndARestart) {
  std::string id;
  {
    ResumableUploads uploads(folder, 100, 1h);
    const api::UploadInfo begun = uploads.create(10, "Doe^Jane\n.mhd");
    id = begun.id;
    EXPECT_EQ(begun.length, 10U);
    EXPECT_EQ(begun.offset, 0U);
    EXPECT_EQ(begun.filename, "Doe^Jane_.mhd");
    EXPECT_EQ(uploads.append(id, 0, bytes("0123")).offset, 4U);
    // A connection breaks: what came stays.
    EXPECT_EQ(refusal([&] {
                uploads.append(id, 4, [](const ResumableUploads::TakeBytes& take) {
                  take("45");
                  throw Error(ErrorCode::malformed, "The body is cut short.");
                });
              }),
              ErrorCode::malformed);
  }
  ResumableUploads uploads(folder, 100, 1h);
  EXPECT_EQ(uploads.find(id).offset, 6U);
  EXPECT_EQ(uploads.find(id).filename, "Doe^Jane_.mhd");
  EXPECT_EQ(refusal([&] { all_of(uploads, id); }), ErrorCode::conflict) << "not whole yet";
  EXPECT_EQ(refusal([&] { uploads.append(id, 4, bytes("4")); }), ErrorCode::conflict);
  EXPECT_EQ(uploads.append(id, 6, bytes("6789")).offset, 10U);
  EXPECT_EQ(all_of(uploads, id), "0123456789");
  EXPECT_EQ(refusal([&] { uploads.append(id, 10, bytes("x")); }), ErrorCode::too_large);
  EXPECT_EQ(uploads.append(id, 10, bytes("")).offset, 10U);
  uploads.remove(id);
  EXPECT_EQ(files(), 0U);
  EXPECT_EQ(refusal([&] { uploads.find(id); }), ErrorCode::not_found);
}

TEST_F(Resumable, TakeOneAppendAtATime) {
  ResumableUploads uploads(folder, 100, 1h);
  const std::string id = uploads.create(10, "").id;
  uploads.append(id, 0, [&](const ResumableUploads::TakeBytes& take) {
    take("01");
    EXPECT_EQ(refusal([&] { uploads.append(id, 2, bytes("2")); }), ErrorCode::conflict);
    EXPECT_EQ(refusal([&] { uploads.remove(id); }), ErrorCode::conflict);
    take("23");
  });
  EXPECT_EQ(uploads.find(id).offset, 4U);
}

TEST_F(Resumable, KeepToTheirLimits) {
  ResumableUploads uploads(folder, 100, 1h, 2);
  EXPECT_EQ(refusal([&] { uploads.create(101, ""); }), ErrorCode::too_large);
  uploads.create(100, "");
  uploads.create(0, "");
  EXPECT_EQ(refusal([&] { uploads.create(1, ""); }), ErrorCode::busy);
}

TEST_F(Resumable, Expire) {
  ResumableUploads uploads(folder, 100, 1h);
  const std::string id = uploads.create(10, "").id;
  age();
  EXPECT_EQ(refusal([&] { uploads.find(id); }), ErrorCode::not_found);
  uploads.create(5, "");
  EXPECT_EQ(files(), 2U) << "what has expired is swept away";
}

// Each sweeps while the others are being made.
TEST_F(Resumable, AreMadeSideBySide) {
  ResumableUploads uploads(folder, 100, 1h, 10'000);
  std::vector<std::jthread> threads;
  std::array<std::vector<std::string>, 8> made;
  std::atomic<int> refused{0};
  for (auto& mine : made) {
    threads.emplace_back([&] {
      for (int i = 0; i < 25; ++i) try {
          mine.push_back(uploads.create(10, "x").id);
          uploads.append(mine.back(), 0, bytes("0123456789"));
        } catch (const Error&) {
          ++refused;
        }
    });
  }
  threads.clear();
  EXPECT_EQ(refused, 0);
  for (const auto& mine : made)
    for (const std::string& id : mine) EXPECT_EQ(uploads.find(id).offset, 10U) << "acknowledged, and gone";
}

class Surrounded : public Resumable {
 protected:
  Time time{std::chrono::hours(24 * 365 * 50)};
  std::uint64_t room = 1000;
  std::vector<std::string> aside;
  Surroundings around() {
    return {.served = [this] { return time; },
            .free_bytes = [this] { return room; },
            .set_aside =
                [this](const std::filesystem::path& file) {
                  if (!std::filesystem::exists(file)) return;
                  aside.push_back(file.extension());
                  std::filesystem::remove(file);
                }};
  }
};

TEST_F(Surrounded, AgeByTheTimeOfService) {
  std::string id;
  {
    ResumableUploads uploads(folder, 100, 1h, 10, around());
    id = uploads.create(10, "").id;
    time += 50min;
    uploads.append(id, 0, bytes("0"));
  }
  // Whatever the clock on the wall says at the next start.
  ResumableUploads uploads(folder, 100, 1h, 10, around());
  time += 59min;
  const api::UploadInfo upload = uploads.find(id);
  EXPECT_EQ(upload.offset, 1U);
  EXPECT_LE(upload.expires, std::chrono::system_clock::now() + 1min);
  time += 2min;
  EXPECT_EQ(refusal([&] { uploads.find(id); }), ErrorCode::not_found);
}

TEST_F(Surrounded, LeaveTheDiskItsReserve) {
  ResumableUploads uploads(folder, 10'000, 1h, 10, around());
  EXPECT_EQ(refusal([&] { uploads.create(1001, ""); }), ErrorCode::no_space);
  const std::string first = uploads.create(700, "").id;
  EXPECT_EQ(refusal([&] { uploads.create(301, ""); }), ErrorCode::no_space) << "what the first lacks is spoken for";
  EXPECT_EQ(refusal([&] { uploads.check_room(301); }), ErrorCode::no_space) << "for everybody";
  EXPECT_EQ(refusal([&] { uploads.check_room(300); }), std::nullopt);
  uploads.append(first, 0, bytes(std::string(600, 'x')));
  room = 400;
  const std::string second = uploads.create(300, "").id;
  // Something else takes the room.
  room = 50;
  EXPECT_EQ(refusal([&] { uploads.append(second, 0, bytes(std::string(51, 'x'))); }), ErrorCode::no_space);
  EXPECT_EQ(uploads.append(second, 0, bytes(std::string(50, 'x'))).offset, 50U);
  room = 0;
  uploads.remove(first);
  EXPECT_EQ(refusal([&] { uploads.find(first); }), ErrorCode::not_found);
}

TEST_F(Surrounded, DamagedOnesAreContained) {
  ResumableUploads uploads(folder, 100, 1h, 10, around());
  const std::string good = uploads.create(10, "").id, deleted = uploads.create(10, "").id;
  for (const char* text : {"", "x", "10\n", "10\nname\n", "10\nname\n-5\n", "10\nname\n9223372036854775807\n"}) {
    const std::string damaged = uploads.create(10, "").id;
    std::ofstream(folder / (damaged + ".info")) << text;
    EXPECT_EQ(refusal([&] { uploads.find(damaged); }), ErrorCode::corrupt) << text;
    EXPECT_EQ(refusal([&] { uploads.append(damaged, 0, bytes("0")); }), ErrorCode::corrupt);
    uploads.remove(uploads.create(10, "").id);  // sweeps
    EXPECT_EQ(aside, (std::vector<std::string>{".part", ".info"})) << text;
    EXPECT_EQ(refusal([&] { uploads.find(damaged); }), ErrorCode::not_found);
    aside.clear();
  }
  std::ofstream(folder / (deleted + ".info")) << "x";
  uploads.remove(deleted);
  EXPECT_EQ(uploads.find(good).length, 10U);
  EXPECT_EQ(files(), 2U);
}

TEST_F(Surrounded, LeftoversOfACrashGo) {
  { ResumableUploads(folder, 100, 1h, 10, around()).create(10, ""); }
  const auto leave = [&](const char* name) { std::ofstream(folder / name) << "10\nname\n5\n"; };
  for (const char* name : {"upl_1.part", "upl_2.new", "upl_3.info", "upl_4.part", "upl_4.new"}) leave(name);
  leave("notes of the operator.txt");
  const ResumableUploads uploads(folder, 100, 1h, 10, around());
  EXPECT_EQ(files(), 3U);
  EXPECT_TRUE(aside.empty());
}

TEST_F(Resumable, TakeNoPathsForIds) {
  ResumableUploads uploads(folder, 100, 1h);
  for (const char* id : {"", "upl_", "../upl_00", "upl_0/../0", "upl_zz", "/etc/passwd"}) {
    EXPECT_EQ(refusal([&] { uploads.find(id); }), ErrorCode::not_found) << id;
  }
}

class Replies : public Folder {};

TEST_F(Replies, AreKeptOverRestartsUntilTheyAreOld) {
  {
    ReplyBook book(folder, 1h);
    EXPECT_EQ(book.recall("k"), std::nullopt);
    EXPECT_EQ(refusal([&] { book.recall("k"); }), ErrorCode::conflict) << "another has it";
    EXPECT_EQ(book.recall("other"), std::nullopt);
    book.release("other");
    EXPECT_EQ(book.recall("other"), std::nullopt);
    book.keep("k", std::string("reply\0with\nlines", 16));
    EXPECT_EQ(book.recall("k"), std::string("reply\0with\nlines", 16));
  }
  ReplyBook book(folder, 1h);
  EXPECT_EQ(book.recall("k"), std::string("reply\0with\nlines", 16));
  EXPECT_EQ(book.recall("other"), std::nullopt) << "a reservation ends with the process";
  age();
  EXPECT_EQ(book.recall("k"), std::nullopt);
}

class SurroundedReplies : public Surrounded {};

TEST_F(SurroundedReplies, DamagedOnesAreNone) {
  ReplyBook book(folder, 1h, around());
  for (const char* key : {"a", "b", "c"}) {
    EXPECT_EQ(book.recall(key), std::nullopt);
    book.keep(key, "the reply");
  }
  const auto file = [&](const char* key) { return folder / sha256_hex(key); };
  std::fstream(file("a"), std::ios::in | std::ios::out).seekp(70).put('?');
  std::filesystem::resize_file(file("b"), 3);
  for (const char* key : {"a", "b"}) {
    EXPECT_EQ(book.recall(key), std::nullopt) << "the request is run again";
    book.keep(key, "another reply");
    EXPECT_EQ(book.recall(key), "another reply");
  }
  EXPECT_EQ(aside.size(), 2U);
  EXPECT_EQ(book.recall("c"), "the reply");
  time += 61min;
  EXPECT_EQ(book.recall("c"), std::nullopt);
}

}  // namespace
}  // namespace spherule::server
