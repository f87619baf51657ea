#!/usr/bin/perl
# SPDX-License-Identifier: GPL-3.0-or-later
#
# shape.pl FILE...: prints what breaks the rules of the house that need more than a line of a C++ file to be seen, each
# as "RULE: FILE:LINE: TEXT". It reads code as clang-format leaves it: what stands at namespace scope begins a line.
use strict;
use warnings;

my $most_lines = 60;  # in a function's body
my $width = 120;      # of a line
my $room = 12;        # columns that a line of prose may leave, once the next line's first word is counted

my %includes;  # unit -> unit -> where; a unit is a header with the source of the same name

sub breach {
  my ($rule, $file, $line, $text) = @_;
  print "$rule: $file:$line: $text\n";
}

# The code alone: comments, texts and directives become blank; lines stay where they are.
sub code_of {
  my ($text) = @_;
  $text =~ s{(R"(\w*)\(.*?\)\2"|"(?:\\.|[^"\\\n])*"|(?<!\w)'(?:\\.|[^'\\\n])+'|//[^\n]*|/\*.*?\*/)}
            {my $gone = $1; ($gone =~ m{^/} ? ' ' : '""') . "\n" x ($gone =~ tr/\n//)}gse;
  $text =~ s{^[ \t]*\#(?:[^\n]*\\\n)*[^\n]*}{"\n" x ($& =~ tr/\n//)}gme;
  return $text;
}

# A function is what opens a brace in a namespace or class, and is none of these nor a value. What is inside one,
# lambdas too, is its own.
sub long_functions {
  my ($file, $text) = @_;
  my ($line, $head, @open) = (1, '');
  my $code = code_of($text);
  while ($code =~ /([{};\n]|[^{};\n]+)/g) {
    my $token = $1;
    if ($token eq "\n") {
      $line++;
      $head .= ' ';
    } elsif ($token eq '{') {
      my $outside = !@open || $open[-1]{kind} eq 'scope';
      my $kind = !$outside || $head =~ /=\s*$|=.*\(\s*$/ ? 'inner'
        : $head =~ /^[^(]*\b(?:namespace|struct|class|union|enum|extern)\b/ ? 'scope' : 'function';
      my ($name) = $head =~ /([\w:~]+)\s*\(/;
      push @open, {kind => $kind, name => $name // '', line => $line};
      $head = '' if $kind ne 'inner';
    } elsif ($token eq '}') {
      my $body = pop @open or die "$file:$line: one brace too many\n";
      my $lines = $line - $body->{line} - 1;
      breach('a function is too long', $file, $body->{line}, "$body->{name} has $lines lines")
        if $body->{kind} eq 'function' && $lines > $most_lines;
      $head = '' if $body->{kind} ne 'inner';
    } else {
      $head = $token eq ';' ? '' : $head . $token;
    }
  }
}

# What a header declares has a comment: above it, after it, above the lines without a blank that it stands in, or, if it
# is a type, on its members. The comment at the head of the file is that of the first such lines. Operators, functions
# that are written out on one line, enumerators on one line and what is in a namespace `detail` need none.
sub undocumented {
  my ($file, $text) = @_;
  my ($commented, $first, $detail) = (0, $text =~ m{\A//.*\n//\n//}, 0);
  $text =~ s/\A(.*^#pragma once\n)//ms or return;
  my $line = 1 + ($1 =~ tr/\n//);
  # A blank line, a comment, or what begins a line with all that is indented or closed after it.
  while ($text =~ m{\G(\n|//.*\n|\S.*\n(?:\n*[ \t].*\n|\n*[\})](?!  // namespace).*\n)*)}g) {
    my ($piece, $at) = ($1, $line);
    $line += $piece =~ tr/\n//;
    $commented = 0 if $piece eq "\n";
    $commented = 1 if $piece =~ m{^//};
    $detail = $1 eq 'namespace' if $piece =~ m{^(namespace|\}  // namespace) (?:\w+::)*detail\b};
    next if $detail || $piece =~ m{^(?:\n|//|\#|\}|template|namespace|using|static_assert|extern|friend)};
    ($first, $commented) = (0, 1) if $first;
    my ($name, $plain);
    if ($piece =~ /^(?:struct|class|enum(?: class)?)(?: \[\[\w+\]\])? (\w+)/) {
      ($name, $plain) = ($1, $piece =~ m{\A[^\n\{]*;|//|\Aenum .*\};$}m);
    } elsif ($piece =~ /^[^=({]*?([\w:>]*\w)\(/) {
      ($name, $plain) = ($1, $1 =~ /::/ || $piece =~ m{^.*\}$|^\S.*\boperator|; +///< });
    }
    breach('a declaration has no comment', $file, $at, $name) if $name && !$plain && !$commented;
  }
}

# Prose whose lines were cut by a reflow: a line that ends amid a sentence though the next word had ample room. Tables
# and examples, which are indented or in columns, keep their lines.
sub broken_comments {
  my ($file, @lines) = @_;
  for my $at (0 .. $#lines - 1) {
    my ($indent, $prose) = $lines[$at] =~ m{^(\s*///?) (\S.*)$} or next;
    my ($word) = $lines[$at + 1] =~ m{^\Q$indent\E (\S+)} or next;
    next if $prose =~ /[.:;!?)]$|\S\s{2,}\S/ || length("$lines[$at] $word") + $room > $width;
    breach('a comment is broken', $file, $at + 1, $prose);
  }
  for my $at (0 .. $#lines - 1) {
    breach('a comment is cut from its declaration', $file, $at + 1, $lines[$at])
      if $lines[$at] =~ m{^\s*///} && $lines[$at + 1] eq '';
  }
}

# Units that include each other, however far around.
my ($count, %number, %lowest, @path, %on_path) = (0);
sub circles {
  my ($unit) = @_;
  $number{$unit} = $lowest{$unit} = $count++;
  push @path, $unit;
  $on_path{$unit} = 1;
  for my $other (sort keys %{$includes{$unit} // {}}) {
    circles($other) unless defined $number{$other};
    $lowest{$unit} = $lowest{$other} if $on_path{$other} && $lowest{$other} < $lowest{$unit};
  }
  return if $lowest{$unit} != $number{$unit};
  my @around = splice @path, (grep { $path[$_] eq $unit } 0 .. $#path)[0];
  $on_path{$_} = 0 for @around;
  my %among = map { $_ => 1 } @around;
  for my $from (@around) {
    for my $to (grep { $among{$_} } sort keys %{$includes{$from} // {}}) {
      my ($file, $line) = @{$includes{$from}{$to}};
      breach('includes go in a circle', $file, $line, "$to leads back here");
    }
  }
}

for my $file (@ARGV) {
  open my $in, '<', $file or die "$file: $!\n";
  my $text = do { local $/; <$in> };
  my @lines = split /\n/, $text;
  (my $unit = $file) =~ s/\.\w+$//;
  for my $at (0 .. $#lines) {
    next unless $lines[$at] =~ /^\s*#\s*include\s*"([^"]+)\.h"/ && $1 ne $unit;
    $includes{$unit}{$1} //= [$file, $at + 1];
  }
  long_functions($file, $text);
  undocumented($file, $text) if $file =~ /\.h$/;
  broken_comments($file, @lines);
}
for my $unit (sort keys %includes) {
  circles($unit) unless defined $number{$unit};
}
